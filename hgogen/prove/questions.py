"""What is asked of an error that falls: how far inputs move it, how far it goes from its start, and its L2 gain.

    inputs  |e+|_P^2 <= (1 - alpha h) |e|_P^2 + h sum_k lambda_k v_k^2,   sum_k lambda_k <= alpha
    start   |e+|_P < |e|_P,   |e(0)|_P <= 1 at every corner of a box
    L2      V' <= -|C e|^2 + sum_k lambda_k v_k^2,   lambda_k <= mu^2

The inputs v_k, such as the errors of an output's samples at the two ends of a call, are at most 1, else independent of
each other. Then |e|_P <= 1 stays so, and from elsewhere |e|_P^2 - 1 falls to 1 - alpha h of itself at each call, by the
flow like exp(-alpha t): |c e| comes to no more than sqrt(c P^-1 c'), and stays there. P is sought for the least of
that, at an alpha that is searched. So it is from a box: a norm is convex, so that its corners speak for the whole, one
of each two that are opposite; or P is sought for the least of the largest over several c.

By the third the L2 norm of C e is at most mu times that of v, beside what the start leaves: the bounded real lemma with
a multiplier for each slope (Boyd, El Ghaoui, Feron, Balakrishnan, "Linear Matrix Inequalities in System and Control
Theory", SIAM (1994), 6.3.2). Of several systems the same P, S and lambda serve them all, and all between them.

What is proved of a step as it runs, as numbers that stand with its code, for whoever signs them.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import Any

import numpy as np

from hgogen.form import Form
from hgogen.observer import Observer, asks_an_observer
from hgogen.prove.convergence import Falls, Flow
from hgogen.prove.inclusion import NO_SCALES, Inclusion, Nothing, Uncertain, state_row
from hgogen.prove.inequality import NOW, Contracts, Inputs, driven, pushed
from hgogen.prove.quadratic import (
    MARGINS,
    Array,
    Quadratic,
    View,
    Weights,
    confirmed,
    even,
    extent,
    floats,
    identity,
    inverse_root,
    rational,
)
from hgogen.prove.semidefinite import Solution, cheapest, holding, settled, shortest, together
from hgogen.reading.given import names_of
from hgogen.rigor.definite import fraction, number, root
from hgogen.rigor.outward import number as outward
from hgogen.sentence import NONE, Reason, because

_INPUTS, _START, _L2 = "a bound of what inputs do", "a bound of the errors from a start", "a bound of an L2 gain"
_SHARES = tuple(Fraction(k, 100) for k in (5, 10, 20, 30, 40, 50, 60, 70, 80, 87, 93))  # of the rate, for alpha
_FIRST = 6  # of them, that is tried first: about half of the rate where one mode decays, more where they are many
_LARGE = 1e30  # in the place of a bound, where none is proved
_MARGIN = 1e-6
_SHARE = Fraction(999_999, 1_000_000)  # of alpha for the lambda, so that they are below it when they are rounded
_OF_L2 = (1e-7, 1e-6, 1e-5, 1e-4)  # margins of its forms
_TIMES = np.append(0.0, np.logspace(-4, 4, 400))  # of the speed of the error, at which its response is looked at
_TRIED = (0.5, 0.7, 1.0, 1.4)  # times an alpha, at which all states are bounded at once

Bounded = Callable[[Fraction], Sequence[Quadratic]]  # by alpha, the forms of which the last multipliers are the lambda
Bounds = Mapping[tuple[str, str], float]  # by the name of a state of the form, and of an output

# --- inputs


@dataclass(frozen=True)
class InputBound:
    """A proof that |c e| <= `bound` where each input is at most 1: by the `weights`, of which the last of S are the
    lambda, at `alpha`."""

    alpha: Fraction
    weights: Weights
    bound: Fraction

    @property
    def written(self) -> dict[str, Any]:
        """The bound as a certificate has it."""
        return {"alpha": self.alpha, **self.weights.written, "bound": self.bound}


def input_bound(bounded: Bounded, W: Array | None, q: int, c: Array, most: Fraction) -> InputBound | None:
    """A small bound of |c e|, c (N) of FLINT's rationals, of the forms that are negative at an alpha, with `q` inputs
    among what multiplies them; alpha is searched in floats up to `most`, and the least bound that is proved counts.
    None where none is proved. `W`: coordinates x, e = W x, near which P is expected. Raises: `NoSolver`."""
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


def step_input_bound(proof: Contracts, inputs: Inputs, c: Array) -> InputBound | None:
    """A bound of |c e| of a step that contracts. Raises: `NoSolver`."""
    step, q = proof.step, inputs.D.shape[1]
    return input_bound(lambda alpha: (step.driven(alpha, inputs),), proof.steps.coordinates, q, c, proof.alpha)


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
    arguments = [form.floats for form in forms], floats(c[None]), float(alpha), W, q
    exactly = confirmed(forms, lambda margin: weights_in_floats(*arguments, margin), q, alpha)
    if exactly is None:
        return None
    return InputBound(alpha, Weights.of(*exactly), root(extent(exactly[0], c)))


def bound_in_floats(bounded: Bounded, W: Array, q: int, c: Array, alpha: Fraction) -> tuple[float, Array] | None:
    """Return the bound in floats, which prove nothing, and coordinates (N, N) in which its P is the unit matrix."""
    forms, row = [form.floats for form in bounded(alpha)], floats(c[None])
    weights = weights_in_floats(forms, row, float(alpha), W, q, _MARGIN)
    if weights is None or any(np.linalg.eigvalsh(form.value(*weights)).max() >= 0 for form in forms):
        return None
    return float(np.sqrt(row[0] @ np.linalg.solve(weights[0], row[0]))), inverse_root(weights[0])


def weights_in_floats(
    forms: Sequence[Quadratic], rows: Array, alpha: float, W: Array, q: int, margin: float
) -> tuple[Array, Array] | None:
    """P and S in floats with a small largest c P^-1 c' of the `rows` c (r, n), sought from coordinates x of e = W x on.
    Raises: `NoSolver`."""

    def sought_in(W: Array) -> Solution | None:
        """The solution in these coordinates, with the inputs in a unit in which x is near 1."""
        unit = alpha / float(np.linalg.norm((np.linalg.inv(W) @ forms[0].pairs[0][1])[:, -q:]))
        view = View(forms, W, np.append(even(forms[0], W)[:-q], [unit] * q))
        return shortest(view, rows @ W, together(forms[0], q, float(_SHARE) * alpha), margin, unit, _INPUTS)

    return settled(sought_in, W)


# --- a start


@dataclass(frozen=True)
class Confined:
    """A proof by the `weights` that an error from the box stays within the `bounds` of |c e|, each by the place of its
    c."""

    weights: Weights
    bounds: Mapping[int, Fraction]


def confined(proof: Contracts, corners: Array, rows: Mapping[int, Array]) -> Confined | None:
    """A proof that makes the largest |c e| small, each c (N) of the `rows` in the unit in which it counts, from the
    `corners` (k, N) of a box, one of each two that are opposite; of FLINT's rationals. None where none is found.
    Raises: `NoSolver`."""
    form, W = proof.step.falls(NOW), proof.steps.coordinates
    if W is None:
        return None
    of, starts, reads = form.floats, floats(corners), floats(np.array(list(rows.values())))

    def sought_in(W: Array, margin: float) -> Solution | None:
        """The solution in these coordinates, with corners near 1."""
        begins = starts @ np.linalg.inv(W).T
        far = float(np.linalg.norm(begins, axis=1).max())
        limits = holding(of, begins / far)
        return shortest(View((of,), W, even(of, W)), reads @ W, limits, margin, 1 / far, _START)

    exactly = confirmed((form,), lambda margin: settled(lambda W: sought_in(W, margin), W))
    return Confined(Weights.of(*exactly), peak_errors(exactly[0], corners, rows)) if exactly else None


def peak_errors(P: Array, corners: Array, rows: Mapping[int, Array]) -> dict[int, Fraction]:
    """Return how far |c e| goes at most: the root of c P^-1 c' times the largest |e(0)|_P^2."""
    begins = fraction(max(corner @ P @ corner for corner in corners))
    return {place: root(extent(P, c) * begins) for place, c in rows.items()}


# --- an L2 gain


@dataclass(frozen=True, eq=False)
class Driven:
    """A system that the error obeys, `e`, with inputs v (q), and what is counted of it, `C` (r, N); of FLINT's
    rationals."""

    e: Uncertain
    C: Array

    @property
    def form(self) -> Quadratic:
        """The form that is negative where V' <= -|C e|^2 + sum_k lambda_k v_k^2; the lambda are the last q of its
        multipliers."""
        form = pushed(self.e, NOW)
        counted, square = 0 * identity(form.size), self.C.T @ self.C
        counted[: len(square), : len(square)] = square
        return replace(form, constant=counted)

    @property
    def peak_response(self) -> float:
        """The largest response of z to v where each slope is at its middle, at the frequencies that are tried."""
        M, B, C = map(floats, (self.e.M, self.e.B, self.C))
        at = 1j * _TIMES[:, None, None] * np.linalg.norm(M, 2) * np.eye(len(M))
        return float(
            np.linalg.norm(C @ np.linalg.solve(at - M, np.broadcast_to(B, (len(at), *B.shape))), 2, (1, 2)).max()
        )


@dataclass(frozen=True)
class L2Bound:
    """A proof that the L2 gain is at most `mu`: by the `weights`, of which the last of S are the lambda."""

    weights: Weights
    mu: Fraction


def l2_bound(each: Sequence[Driven], W: Array, growing: Array | None = None) -> L2Bound | None:
    """A small bound of the L2 gain that all of the systems have; None where none is proved. `W` (N, N): coordinates x,
    e = W x, in which P is expected to be near the unit matrix; `growing` (N, N), of rationals: D of a term -r D e, r >=
    0 of any size, so that D'P + P D >= 0 is asked for. Raises: `NoSolver`."""
    forms, q, n = [one.form for one in each], each[0].e.B.shape[1], len(W)
    k, back, most = len(forms[0].Q), np.linalg.inv(W), max(one.peak_response for one in each)
    if growing is not None:
        nothing = 0 * growing[:1].repeat(k, axis=0)
        forms.append(Quadratic(((identity(n), -growing),), nothing, nothing))
    fastest = max(np.linalg.norm(back @ floats(one.e.M) @ W, 2) for one in each)
    scale = max(np.linalg.norm(floats(one.C) @ W, 2) for one in each) ** 2 / fastest  # of P, which is then near 1
    g = np.append(even(forms[0].floats, W)[: k - q], [np.sqrt(scale) / most] * q)  # so that mu is near 1
    of = [form.floats for form in forms]
    view = View([one if one.constant is None else replace(one, constant=one.constant / scale) for one in of], W, g)

    def by_margin(by: float) -> tuple[Array, Array] | None:
        candidate = cheapest(view.forms, q, by, _L2)
        if candidate is None:
            return None
        P, S = view.back(*candidate)
        return P * scale, S * scale

    exactly = confirmed(forms, by_margin, margins=_OF_L2)
    return L2Bound(Weights.of(*exactly), root(fraction(max(exactly[1][-q:].tolist())))) if exactly else None


# --- noise in continuous time


def obeyed(observer: Observer) -> Inclusion | Nothing:
    """Return what the error of an observer of a constant injection obeys, or why that is not known."""
    known: Inclusion | Nothing | None = observer.error
    why = "the proof is for a constant injection: high_gain, filtered and the like, on chains"
    return Nothing(because(why)) if known is None else known


def theta_of(observer: Observer) -> Fraction:
    """The declared theta."""
    (theta,) = (gain.initial[0] for gain in observer.gains if gain.name == "theta")
    return Fraction(theta)


@asks_an_observer
def noise_bounds(observer: Observer) -> Bounds | Nothing:
    """Return, by the name of a state of the form and of an output, how far the estimate of the one goes at most for
    noise of at most 1 of the other, in continuous time, at the declared gains of an observer of a constant injection;
    or why that is not known. Raises: `NoSolver`."""
    error = obeyed(observer)
    if isinstance(error, Nothing):
        return error
    flow = Flow(error, theta_of(observer))
    if flow.fastest is None:
        return Nothing(flow.obstacle(observer.form.states))
    known = bounds(flow, flow.fastest)
    return Nothing(known) if isinstance(known, Reason) else named(observer.form, known)


def named(form: Form, known: Mapping[tuple[int, int], float]) -> Bounds:
    """Bounds by state of the form and output, by their names."""
    outputs = names_of(form.system.outputs)
    return {(form.names[i], outputs[j]): bound for (i, j), bound in known.items()}


def bounds(flow: Flow, falls: Falls) -> Mapping[tuple[int, int], float] | Reason:
    """Return, by state of the form and by output, the proved bound of what noise of at most 1 does, in their units, of
    an error that `falls`; or why there is none. Raises: `NoSolver`."""
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

        for i, place in picks:
            one = input_bound(forms, W, 1, state_row(scales, place), Fraction(1))
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
    rows = rows @ np.array([floats(state_row(scales, k)[None])[0] for k in error.layout.picks])
    for share in _TRIED:
        candidate = weights_in_floats(driven(e, share, error.hull), rows, share, W, len(sizes), _MARGIN)
        if candidate is not None and np.linalg.eigvalsh(candidate[0]).min() > 0:
            squares = np.einsum("ij,ij->i", rows, np.linalg.solve(candidate[0], rows.T).T)
            speed = alpha * float(np.sqrt(np.linalg.eigvalsh(e.B.T @ candidate[0] @ e.B).max()))
            least = min(least, float(np.sqrt(squares.max())) * max(1.0, speed / fastest))
    return least


def _over(e: Uncertain, pace: Any) -> Uncertain:
    """Return the system in a time that runs `pace` times as fast, so that rates are near 1; in the arithmetic of
    both."""
    return replace(e, M=e.M / pace, G=e.G / pace, B=e.B / pace, core=e.core / pace, injected=e.injected / pace)


Each = Mapping[str, float]


@dataclass(frozen=True)
class Signed:
    """Bounds of how far the estimate of a step errs, and under which assumptions.

    `bounds`: by the name of a state; within 1.1 of it is its error from `settles` (the model's unit of time) on, of
    first errors of at most `begins`, by the name of a state of the form; `everywhere`: whether these are all that the
    ranges allow. None, and empty, where nothing is known of starts, and `unsettled` says why. `assumed`: by what enters
    ("noise" and the like) and by the name of a signal, how large it is at most; `real`: the precision in which what the
    program rounds is counted, None where it is not; `inside`: by how much the plant keeps clear of the ends of its
    ranges; `beyond`: the states of which no bound within the width of their range is proved. `least`: from which
    constant theta up to its own the error decays without what enters, and `longest`: at which dt up to that one, of its
    own theta; None where that is not proved. Without `bounds` none is proved.
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
