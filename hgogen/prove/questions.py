"""Bounds of an error that decays: its ultimate bound under inputs, its peak from a set of initial errors, and its L2
gain.

    inputs  |e+|_P^2 <= (1 - alpha h) |e|_P^2 + h sum_k lambda_k v_k^2,   sum_k lambda_k <= alpha
    start   |e+|_P < |e|_P,   |e(0)|_P <= 1 at every corner of a box
    L2      V' <= -|C e|^2 + sum_k lambda_k v_k^2,   lambda_k <= mu^2

1. The inputs v_k, such as the errors of an output's samples at the two ends of a call, are at most 1, and otherwise
independent of each other. Then |e|_P <= 1 is invariant. From outside |e|_P^2 - 1 is multiplied by at most 1 - alpha h
at each call, by the flow by exp(-alpha t). So |c e| is at most sqrt(c P^-1 c') in the end. A solver seeks the P with
the least bound, at an alpha that is searched.

2. Errors that begin in a box remain in the level set around it, which bounds the peak of |c e|. A norm is convex, so
the corners represent the box, one of each two that are opposite. For several c the solver minimises the largest bound.

3. The L2 norm of C e is at most mu times that of v, plus a term of the start: the bounded real lemma with a multiplier
for each slope (Boyd, El Ghaoui, Feron, Balakrishnan, "Linear Matrix Inequalities in System and Control Theory", SIAM
(1994), 6.3.2). For several systems the same P, S and lambda hold for all of them, and their convex combinations.

`Signed` holds the proved numbers that the code of a step states.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import Any

import numpy as np

from hgogen.form import Form
from hgogen.observer import Observer, asks_an_observer
from hgogen.prove.convergence import DecayProof, Flow
from hgogen.prove.inclusion import NO_SCALES, Inclusion, Nothing, Uncertain, state_row
from hgogen.prove.inequality import NOW, Contracts, Inputs, driven_by_multipliers, noise_forms
from hgogen.prove.quadratic import (
    MARGINS,
    Array,
    Quadratic,
    ScaledForms,
    Weights,
    balanced_units,
    confirmed,
    extent,
    floats,
    identity,
    inverse_root,
    rational,
)
from hgogen.prove.semidefinite import (
    Solution,
    best_solution,
    norm_limits,
    smallest_extent,
    smallest_multipliers,
    sum_limit,
)
from hgogen.reading.given import names_of
from hgogen.rigor.definite import fraction, number, root
from hgogen.rigor.outward import number as outward
from hgogen.sentence import NONE, Reason, because

_INPUTS, _START, _L2 = "a bound of what inputs do", "a bound of the errors from a start", "a bound of an L2 gain"
_SHARES = tuple(Fraction(k, 100) for k in (5, 10, 20, 30, 40, 50, 60, 70, 80, 87, 93))  # of the rate, for alpha
_FIRST = 6  # index of the first one: half of the rate is best for one mode, more for many
_LARGE = 1e30  # the bound where none is proved
_MARGIN = 1e-6
_SHARE = Fraction(999_999, 1_000_000)  # sum of the lambda over alpha, with room for rounding
_OF_L2 = (1e-7, 1e-6, 1e-5, 1e-4)  # margins of the forms of an L2 gain
_TIMES = np.append(0.0, np.logspace(-4, 4, 400))  # frequencies of the peak response, over the speed of the error
_TRIED = (0.5, 0.7, 1.0, 1.4)  # factors of alpha in a bound of all states at once

Bounded = Callable[[Fraction], Sequence[Quadratic]]  # the forms at an alpha, with the lambda as last multipliers
Bounds = Mapping[tuple[str, str], float]  # by the name of a state of the form, and of an output

# --- inputs


@dataclass(frozen=True)
class InputBound:
    """A proof that |c e| is finally at most `bound` for inputs |v_k| <= 1, by the inequality |e+|_P^2 <= (1 - alpha h)
    |e|_P^2 + h sum_k lambda_k v_k^2 with sum_k lambda_k <= `alpha`. `weights`: P, and S, whose last entries are the
    lambda_k."""

    alpha: Fraction
    weights: Weights
    bound: Fraction


def input_bound(bounded: Bounded, W: Array | None, q: int, c: Array, most: Fraction) -> InputBound | None:
    """Return a proved bound of |c e|, c (N) in FLINT's rationals, under `q` inputs |v_k| <= 1 that vary arbitrarily;
    None where none is proved. By the noise inequality with sum_k lambda_k <= alpha, |e|_P <= 1 is invariant, so that |c
    e|^2 <= c P^-1 c'.

    `bounded(alpha)`: the quadratic forms of the noise inequality, whose last multipliers are the lambda_k; `most`: the
    largest alpha of the search for the smallest bound; `W`: coordinates e = W x in which P is expected close to the
    unit matrix, None for none. Raises: `NoSolver`.
    """
    if W is None:
        return None
    tried, coordinates = dict[Fraction, float](), W

    def bound(share: Fraction) -> float:
        alpha = share * most
        forms, row = [form.floats for form in bounded(alpha)], floats(c[None])
        weights = weights_in_floats(forms, row, float(alpha), coordinates, q, MARGINS[0])
        square = 0.0 if weights is None else float(row[0] @ np.linalg.solve(weights[0], row[0]))
        tried[alpha] = float(root(Fraction(square))) if 0 < square < _LARGE else _LARGE
        return tried[alpha]

    _search_shares(bound)
    proofs = (bound_at(bounded, coordinates, q, c, alpha) for alpha in sorted(tried, key=tried.__getitem__))
    return next(filter(None, proofs), None)


def step_input_bound(proof: Contracts, inputs: Inputs, c: Array) -> InputBound | None:
    """Return a proved bound of |c e|, c (N), under `inputs` of at most 1 at each call, for the step whose contraction
    is proved by `proof`; None where none is proved. Raises: `NoSolver`."""
    step, q = proof.step, inputs.D.shape[1]
    return input_bound(lambda alpha: (step.driven(alpha, inputs),), proof.steps.coordinates, q, c, proof.alpha)


def _search_shares(bound: Callable[[Fraction], float]) -> None:
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
    """Return a proved bound of |c e|, c (N), under `q` inputs of at most 1, by the noise inequality at this `alpha`;
    None where none is proved. `bounded`, `W` as in `input_bound`. Raises: `NoSolver`."""
    forms = bounded(alpha)
    arguments = [form.floats for form in forms], floats(c[None]), float(alpha), W, q
    exactly = confirmed(forms, lambda margin: weights_in_floats(*arguments, margin), q, alpha)
    if exactly is None:
        return None
    return InputBound(alpha, Weights.of(*exactly), root(extent(exactly[0], c)))


def bound_in_floats(bounded: Bounded, W: Array, q: int, c: Array, alpha: Fraction) -> tuple[float, Array] | None:
    """Return an unproved bound of |c e|, c (N), under `q` inputs of at most 1, and P^(-1/2) (N, N), for a P in floats
    that satisfies the noise inequality at this `alpha`; None where the solver finds no such P. `bounded`, and `W`, the
    solver's coordinates, as in `input_bound`."""
    forms, row = [form.floats for form in bounded(alpha)], floats(c[None])
    weights = weights_in_floats(forms, row, float(alpha), W, q, _MARGIN)
    if weights is None or any(np.linalg.eigvalsh(form.value(*weights)).max() >= 0 for form in forms):
        return None
    return float(np.sqrt(row[0] @ np.linalg.solve(weights[0], row[0]))), inverse_root(weights[0])


def weights_in_floats(
    forms: Sequence[Quadratic], rows: Array, alpha: float, W: Array, q: int, margin: float
) -> tuple[Array, Array] | None:
    """Return P and S, in floats, that make the `forms` negative by `margin`, with sum_k lambda_k <= `alpha` (the last
    `q` entries of S) and a small largest c P^-1 c' over the `rows` c (r, n); None where the solver finds none. `W`: the
    coordinates e = W x of the first program. Raises: `NoSolver`."""

    def sought_in(W: Array) -> Solution | None:
        unit = alpha / float(np.linalg.norm((np.linalg.inv(W) @ forms[0].pairs[0][1])[:, -q:]))
        view = ScaledForms(forms, W, np.append(balanced_units(forms[0], W)[:-q], [unit] * q))
        return smallest_extent(view, rows @ W, sum_limit(forms[0], q, float(_SHARE) * alpha), margin, unit, _INPUTS)

    return best_solution(sought_in, W)


# --- a start


@dataclass(frozen=True)
class Confined:
    """A proof that errors e with initial values in a box have |c e| <= bound at all times, because e'P e, with the
    `weights` P and S, does not grow. `bounds`: the bound by key of the row c."""

    weights: Weights
    bounds: Mapping[int, Fraction]


def confinement(form: Quadratic, W: Array | None, corners: Array, rows: Mapping[int, Array]) -> Confined | None:
    """Return a proof of small bounds of |c e| for all times, for initial errors in a box; None where there is none.

    `form`: the quadratic form that is negative where |e|_P does not grow; `W`: coordinates e = W x in which P is
    expected close to the unit matrix, None for none; `corners` (k, N): those of the box, one of each opposite pair;
    `rows`: the rows c (N) by key, each in the unit in which its bound counts. All numbers are FLINT's rationals.
    Raises: `NoSolver`.
    """
    if W is None:
        return None
    in_floats, starts, reads = form.floats, floats(corners), floats(np.array(list(rows.values())))

    def sought_in(W: Array, margin: float) -> Solution | None:
        begins = starts @ np.linalg.inv(W).T
        far = float(np.linalg.norm(begins, axis=1).max())
        limits = norm_limits(in_floats, begins / far)
        return smallest_extent(
            ScaledForms((in_floats,), W, balanced_units(in_floats, W)), reads @ W, limits, margin, 1 / far, _START
        )

    exactly = confirmed((form,), lambda margin: best_solution(lambda W: sought_in(W, margin), W))
    return Confined(Weights.of(*exactly), peak_errors(exactly[0], corners, rows)) if exactly else None


def peak_errors(P: Array, corners: Array, rows: Mapping[int, Array]) -> dict[int, Fraction]:
    """Return, by key of the `rows` c, the largest |c e| for all times if |e|_P does not grow from initial errors in the
    box with these `corners` e(0): sqrt(c P^-1 c' max e(0)'P e(0))."""
    begins = fraction(max(corner @ P @ corner for corner in corners))
    return {place: root(extent(P, c) * begins) for place, c in rows.items()}


# --- an L2 gain


@dataclass(frozen=True, eq=False)
class Driven:
    """An error system `e` with inputs v (q) and the weighted error `C` e, C (r, N), as the output whose L2 gain is
    bounded."""

    e: Uncertain
    C: Array

    @property
    def form(self) -> Quadratic:
        """The quadratic form that is negative where V' <= -|C e|^2 + sum_k lambda_k v_k^2, V = e'P e (bounded real
        lemma). The lambda_k are its last q multipliers."""
        form = driven_by_multipliers(self.e, NOW)
        counted, square = 0 * identity(form.size), self.C.T @ self.C
        counted[: len(square), : len(square)] = square
        return replace(form, constant=counted)

    @property
    def peak_response(self) -> float:
        """The largest |C (i omega - M)^-1 B| over 401 frequencies, each slope at the middle of its range, in floats."""
        M, B, C = map(floats, (self.e.M, self.e.B, self.C))
        at = 1j * _TIMES[:, None, None] * np.linalg.norm(M, 2) * np.eye(len(M))
        return float(
            np.linalg.norm(C @ np.linalg.solve(at - M, np.broadcast_to(B, (len(at), *B.shape))), 2, (1, 2)).max()
        )


@dataclass(frozen=True)
class L2Bound:
    """A proof that the L2 gain from v to C e is at most `mu`, by V' <= -|C e|^2 + sum_k lambda_k v_k^2 with lambda_k <=
    mu^2. `weights`: P of V = e'P e, and S, whose last entries are the lambda_k."""

    weights: Weights
    mu: Fraction


def l2_bound(each: Sequence[Driven], W: Array, growing: Array | None = None) -> L2Bound | None:
    """Return a proved bound mu of the L2 gain from v to C e, by one V = e'P e for all systems `each`; None where none
    is proved.

    `W` (N, N): coordinates e = W x in which P is expected close to the unit matrix; `growing`: a matrix D (N, N) in
    rationals for an e' with an additional term -r D e, r >= 0 of any size, which requires D'P + P D >= 0; None for
    none. Raises: `NoSolver`.
    """
    forms, q, n = [one.form for one in each], each[0].e.B.shape[1], len(W)
    k, back, most = len(forms[0].Q), np.linalg.inv(W), max(one.peak_response for one in each)
    if growing is not None:
        nothing = 0 * growing[:1].repeat(k, axis=0)
        forms.append(Quadratic(((identity(n), -growing),), nothing, nothing))
    fastest = max(np.linalg.norm(back @ floats(one.e.M) @ W, 2) for one in each)
    scale = max(np.linalg.norm(floats(one.C) @ W, 2) for one in each) ** 2 / fastest  # of P, so that it is near 1
    g = np.append(balanced_units(forms[0].floats, W)[: k - q], [np.sqrt(scale) / most] * q)  # so that mu is near 1
    in_floats = (form.floats for form in forms)
    scaled = [one if one.constant is None else replace(one, constant=one.constant / scale) for one in in_floats]
    view = ScaledForms(scaled, W, g)

    def by_margin(by: float) -> tuple[Array, Array] | None:
        candidate = smallest_multipliers(view.forms, q, by, _L2)
        if candidate is None:
            return None
        P, S = view.back(*candidate)
        return P * scale, S * scale

    exactly = confirmed(forms, by_margin, margins=_OF_L2)
    return L2Bound(Weights.of(*exactly), root(fraction(max(exactly[1][-q:].tolist())))) if exactly else None


# --- noise in continuous time


def error_inclusion(observer: Observer) -> Inclusion | Nothing:
    """Return the error dynamics of an observer with a constant injection gain; `Nothing`, with the reason, for other
    observers."""
    known: Inclusion | Nothing | None = observer.error
    why = "the proof is for a constant injection: high_gain, filtered and the like, on chains"
    return Nothing(because(why)) if known is None else known


def theta_of(observer: Observer) -> Fraction:
    """Return the declared value of the observer's gain theta."""
    (theta,) = (gain.initial[0] for gain in observer.gains if gain.name == "theta")
    return Fraction(theta)


@asks_an_observer
def noise_bounds(observer: Observer) -> Bounds | Nothing:
    """Return the ultimate bounds of errors under noise, in continuous time, by (name of a state of the form, name of an
    output): the largest error of the state for noise of at most 1 in this output; or the reason why there is no proof.
    The observer has a constant injection gain at its declared theta. Raises: `NoSolver`."""
    error = error_inclusion(observer)
    if isinstance(error, Nothing):
        return error
    flow = Flow(error, theta_of(observer))
    if flow.fastest is None:
        return Nothing(flow.obstacle(observer.form.states))
    known = bounds(flow, flow.fastest)
    return Nothing(known) if isinstance(known, Reason) else bounds_by_name(observer.form, known)


def bounds_by_name(form: Form, known: Mapping[tuple[int, int], float]) -> Bounds:
    """Return the bounds by (state, output) names, from `known` bounds by their indices."""
    outputs = names_of(form.system.outputs)
    return {(form.names[i], outputs[j]): bound for (i, j), bound in known.items()}


def bounds(flow: Flow, falls: DecayProof) -> Mapping[tuple[int, int], float] | Reason:
    """Return, by (state, output) indices, the proved ultimate bound of the state's error under noise of at most 1 in
    the output, in continuous time, for an error that decays by the proof `falls`; or the reason why there is none.
    Raises: `NoSolver`."""
    error, scales = flow.error, flow.error.scales(flow.theta)
    if scales is None:
        return NO_SCALES
    e, W = error.at(flow.theta), inverse_root(floats(rational(falls.weights.P)))
    e, picks, every = _rescaled(e, number(falls.alpha)), list(enumerate(error.layout.picks)), range(e.B.shape[1])
    known = {(i, j): 0.0 for i, _ in picks for j in every}  # 0 for an output that is not injected
    for j in np.flatnonzero(np.vstack([e.B, e.E]).any(axis=0)).tolist():
        alone = e.driven_by(np.eye(len(every), dtype=int)[:, [j]])

        def forms(alpha: Fraction, system: Uncertain = alone) -> tuple[Quadratic, ...]:
            return noise_forms(system, alpha, error.hull)

        for i, place in picks:
            one = input_bound(forms, W, 1, state_row(scales, place), Fraction(1))
            if one is None:
                return because("no bound is found of what noise does")
            known[i, j] = outward(one.bound)[1]
    return known


def joint_bound_in_floats(
    error: Inclusion, sizes: Array, rows: Array, falls: DecayProof, alpha: float, fastest: float
) -> float:
    """Return an unproved bound of |c z| over all `rows` c (r, n), z the errors of the form's states, under noise of at
    most `sizes` (p) in all outputs together, in continuous time; infinite where the solver finds none.

    One V bounds all rows, for the best of four values close to `alpha` in the noise inequality. Where noise alone
    changes the error faster than `fastest` (1/time) in the norm of V, the bound is multiplied by the ratio. Raises:
    `NoSolver`.
    """
    scales = error.scales(falls.theta)
    assert scales is not None
    e, W = error.at(falls.theta).floats, inverse_root(floats(rational(falls.weights.P)))
    e, least = _rescaled(e.driven_by(np.diag(sizes)), alpha), float("inf")
    rows = rows @ np.array([floats(state_row(scales, k)[None])[0] for k in error.layout.picks])
    for share in _TRIED:
        candidate = weights_in_floats(noise_forms(e, share, error.hull), rows, share, W, len(sizes), _MARGIN)
        if candidate is not None and np.linalg.eigvalsh(candidate[0]).min() > 0:
            squares = np.einsum("ij,ij->i", rows, np.linalg.solve(candidate[0], rows.T).T)
            speed = alpha * float(np.sqrt(np.linalg.eigvalsh(e.B.T @ candidate[0] @ e.B).max()))
            least = min(least, float(np.sqrt(squares.max())) * max(1.0, speed / fastest))
    return least


def _rescaled(e: Uncertain, pace: Any) -> Uncertain:
    """Return the system e with e' divided by `pace`, in a time
    unit 1/`pace` as long, so that rates are near 1."""
    return replace(e, M=e.M / pace, G=e.G / pace, B=e.B / pace, core=e.core / pace, injected=e.injected / pace)


Each = Mapping[str, float]


@dataclass(frozen=True)
class Signed:
    """Bounds of the estimate's errors for a step, and their assumptions.

    `bounds`: by the name of a state; its error is within 1.1 times that from `settles` (the model's unit of time) on,
    for initial errors of at most `begins`, by the name of a state of the form; `everywhere`: whether these are all that
    the ranges allow. If nothing is known of starts, `settles` is None, `begins` empty, and `unsettled` says why.
    `assumed`: the largest size of each input ("noise" and the like) by the name of a signal; `real`: the precision for
    which rounding errors are counted, None if they are not; `inside`: the distance by which the plant keeps clear of
    the ends of its ranges; `beyond`: the states without a proved bound within the width of their range. `least`: the
    least constant theta from which on, up to its own, the error decays without inputs; `longest`: the longest dt up to
    which it does, at its own theta; None where that is not proved. Without `bounds` none is proved.
    """

    bounds: Each = field(default_factory=dict)
    settles: float | None = None
    unsettled: Reason = NONE
    begins: Each = field(default_factory=dict)
    everywhere: bool = False
    assumed: Mapping[str, Each] = field(default_factory=dict)
    real: str | None = None
    inside: Each = field(default_factory=dict)
    beyond: tuple[str, ...] = ()
    least: Fraction | None = None
    longest: Fraction | None = None
