"""Observers that inject the output error through a saturation or a dead zone with an adaptive level, and their decay.

    w' = A w + c(w, u) + D_l K i(e),   i(e) = sat e or e - sat e,   |sat e| <= sqrt sigma,   l = theta
    sigma' = l (-lambda sigma + r e^2),   sigma >= 0
    eps' = l (N eps - K (eps_1 - i(eps_1))) + J eps,   sigma' = l (-lambda sigma + r eps_1^2),   N = A - K C

Neither has a linear error core for noise: the level follows the noise. The step length is limited by the fastest core,
which injects all of e, and by the decay of sigma.

First the linear core, J = 0, l = theta, C = (1, 0, .., 0). Dead zone, i(e) = e - s, s = sat e at +- sqrt sigma: V =
eps'P eps + mu sigma. With -lambda sigma <= -lambda s^2, s (eps_1 - s) >= 0, V' is at most l times the quadratic form in
(eps, s)

    eps'(N'P + P N) eps + 2 eps'P K s + mu (r eps_1^2 - lambda s^2) + 2 tau s (eps_1 - s)

Saturation, i(e) = sat e = e - q: V = eps'P eps + mu max(eps_1^2 - sigma, 0). Where q = 0, V' = l eps'(N'P + P N) eps;
elsewhere sigma = (eps_1 - q)^2, q (eps_1 - q) >= 0, and V' is at most l times the form in (eps, q)

    eps'(N'P + P N) eps + 2 eps'P K q + mu (2 eps_1 C (N eps + K q) + lambda (eps_1 - q)^2 - r eps_1^2)
    + 2 tau q (eps_1 - q);  eps decays, and sigma after it

A form that is negative for some mu > 0, tau >= 0 proves exponential decay from any eps(0) and sigma(0) >= 0. P solves
N'P + P N = -I in the coordinates g^(i-1) eps_i, g, mu and tau are powers of two: sufficient, not necessary. The idea of
the forms: Alessandri, Zaccarian, "Stubborn state observers for linear time-invariant systems", Automatica 88 (2018).

With a model V is that of the linear core, with N + J/l in the place of N. Its form is affine in each slope of b, as J
is, so it is negative for all slopes in their ranges if it is at the corners. The same holds for the form where q = 0,
(N + J/l)'P + P (N + J/l). For too many corners each slope has a multiplier: with h its reading and v its input, d (v h'
+ h v') <= S h h' + v v'/S for |d| <= 1. V' <= -alpha V adds alpha/l times V to the form; for the dead zone, whose V
holds sigma, alpha is at most l lambda. A V that is valid at a theta is valid at every larger one, as J/l shrinks, and 0
is in the ranges (`convergence`).
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from itertools import product
from typing import Any, ClassVar

import casadi as ca
import numpy as np
from flint import fmpq_mat

from hgogen.analysis.dynamics import HUGE
from hgogen.analysis.evidence import Evidence, Grounds
from hgogen.check import Check, ClaimId, Verdict
from hgogen.estimators.gains import as_matrix
from hgogen.estimators.integrators import (
    Integrators,
    companion,
    injection_gains,
    integrators,
    listed,
    observer_on,
    scaled,
    shifted,
)
from hgogen.form import Form
from hgogen.observer import Observer, demand_form, gain, high_gain_parameter
from hgogen.part import Ode
from hgogen.program import Block, Field, Place, scalar, sym
from hgogen.prove.convergence import CLOSE, SLOW, DecayProof, Flow, convergence_checks, unknown_checks
from hgogen.prove.error_models import GROWTHS, from_form, inclusion, nominal_units, obstacle, plain
from hgogen.prove.inclusion import Nothing
from hgogen.prove.inequality import few_corners
from hgogen.prove.quadratic import Array, Weights, fractions, rational
from hgogen.prove.semidefinite import STATES, lyapunov
from hgogen.reading.given import BadGain, positive, real
from hgogen.rigor import definite
from hgogen.rigor.definite import Matrix, exact
from hgogen.sentence import Reason, because
from hgogen.theorem import Theorem

FEW = 6  # the most states with several values of g
_PAIRS = tuple((2.0**i, 2.0**j) for i, j in product(range(-12, 13), repeat=2))  # mu and tau
_SMALL = 1e-9  # of a form's entries: by how much it is negative where floats take it to be
_BITS = 24  # bits after the point of a multiplier


@dataclass(frozen=True)
class Shape:
    """The shape of a limited injection i(e) of the output error e: `injected`, the function of (e, sat e); `text`, its
    formula.

    `below`: whether r must be below the decay lambda of the level; `drift`: the terms of the weight mu in the quadratic
    form, as a function of (N, K, C, lambda, r) that returns a block (n, n), a column (n) and a corner; `kept`: the
    factors of 2 eps_1 s and of s^2 (or q) in a bound of V over mu; `most`: whether V decays no faster than the level
    sigma; `fix`: advice where there is no proof.
    """

    name: str
    text: str
    injected: Callable[[Any, Any], Any]
    below: bool
    drift: Callable[[Any, Any, Any, Any, Any], tuple[Any, Any, Any]]
    kept: tuple[int, int]
    most: bool
    fix: str


def _squared(N: Any, K: Any, C: Any, decay: Any, r: Any) -> tuple[Any, Any, Any]:
    """Return -lambda s^2 + r eps_1^2 as a quadratic form of (eps, s): its block (n, n), column (n) and corner."""
    return r * np.outer(C, C), 0 * C, -decay


def _beyond(N: Any, K: Any, C: Any, decay: Any, r: Any) -> tuple[Any, Any, Any]:
    """Return 2 eps_1 C (N eps + K q) + lambda (eps_1 - q)^2 - r eps_1^2 in (eps, q): block, column, corner."""
    first = np.outer(C, N[0])
    return first + first.T + (decay - r) * np.outer(C, C), (K[0] - decay) * C, decay


DEAD_ZONE = Shape(
    name="dead zone",
    text="(e - sat(e))",
    injected=lambda e, sat: e - sat,
    below=True,
    drift=_squared,
    kept=(0, 1),
    most=True,
    fix="Lower r.",
)
SATURATION = Shape(
    name="saturation",
    text="sat(e)",
    injected=lambda e, sat: sat,
    below=False,
    drift=_beyond,
    kept=(1, -1),
    most=False,
    fix="Raise r.",
)


@dataclass(frozen=True)
class Adaptation:
    """The adaptation law sigma' = theta (-`decay` sigma + `r` e^2) of the level sqrt(sigma) at which an injection of a
    `shape` (dead zone or saturation) is limited."""

    shape: Shape
    decay: Fraction
    r: Fraction

    def form(self, N: Any, K: Any, P: Any, mu: Any, tau: Any) -> Any:
        """Return the symmetric matrix (n + 1, n + 1) of a quadratic form that bounds V'/theta, in (eps, s) or (eps, q),
        eps the error. N, P (n, n), K (n), in floats or rationals; for k values of mu and tau it is (k, n + 1, n +
        1)."""
        number = Fraction if isinstance(mu, Fraction) else float
        n, (decay, r) = len(K), (number(self.decay), number(self.r))
        C = np.array([number(1), *[number(0)] * (n - 1)])
        block, column, corner = self.shape.drift(N, K, C, decay, r)
        outer = np.multiply.outer
        top, side = N.T @ P + P @ N + outer(mu, block), P @ K + outer(tau, C) + outer(mu, column)
        last = np.concatenate([side, np.asarray(mu * corner - 2 * tau)[..., None]], -1)
        return np.concatenate([np.concatenate([top, side[..., None]], -1), last[..., None, :]], -2)

    def value(self, P: Any, mu: Any) -> Any:
        """Return the symmetric matrix (n + 1, n + 1) of a quadratic form that bounds V, in (eps, s) or (eps, q), in
        floats or rationals."""
        side, corner = np.array([self.shape.kept[0] * mu, *[mu * 0] * (len(P) - 1)]), self.shape.kept[1] * mu
        return np.vstack([np.column_stack([P, side]), [*side, corner]])


@dataclass(frozen=True)
class Decay:
    """A proof that the linear error eps' = N eps - K i(e) and the level decay: the function V of `P` (n, n) and the
    weight `mu`, with the multiplier `tau`, has a negative derivative in the coordinates `growth`^(i-1) eps_i."""

    adaptation: Adaptation
    growth: Fraction
    P: Matrix
    mu: Fraction
    tau: Fraction

    def evidence(self, form: Form) -> Evidence:
        """Return P, mu, tau and the units growth^(i-1) of the coordinates, under the keys of a certificate."""
        units = [self.growth**i for i in range(len(self.P))]
        return {"units": units, "P": self.P, "mu": self.mu, "tau": self.tau}


def decays(adaptation: Adaptation, K: np.ndarray) -> tuple[Decay, ...]:
    """Return proofs that the linear error, with a Hurwitz matrix A - K C, K (n), and this adaptation law, decays; each
    in other coordinates growth^(i-1) eps_i, empty where there is none."""
    growths = GROWTHS[: 0 if len(K) > STATES else 1 if len(K) > FEW else None]
    proofs = (_decay(adaptation, np.array([Fraction(float(k)) for k in K]), growth) for growth in growths)
    return tuple(one for one in proofs if one is not None)


def core_check(maker: str, adaptation: Adaptation, proofs: Iterable[Decay], numbers: Mapping[str, Any]) -> Check:
    """Return the check `MAKER.core`, that the linear error behind the limited injection decays, by the first of the
    `proofs`. `maker`: the observer's name; `numbers`: its arguments for the certificate."""
    id = ClaimId(maker, "core")
    claim = f"the linear error core decays behind its {adaptation.shape.name}, from any initial error"
    for one in proofs:
        pattern = "by a quadratic form with mu = {mu:g}, tau = {tau:g}, in rational arithmetic"
        reason = because(pattern, mu=float(one.mu), tau=float(one.tau))
        return Check(id, claim, Verdict.PROVED, reason, proofs=(Grounds(numbers, one),))
    reason = because("no quadratic proof was found for these lambda and r")
    return Check(id, claim, Verdict.UNKNOWN, reason, fix=adaptation.shape.fix)


def _decay(adaptation: Adaptation, K: Any, growth: Fraction) -> Decay | None:
    scale = np.array([growth**i for i in range(len(K))])
    N, gain = companion(K) * np.outer(scale, 1 / scale), K * scale
    solution = lyapunov(tuple(map(tuple, N)))
    if solution is None:
        return None
    P = np.array(solution.P)
    N_, K_, P_ = (array.astype(float) for array in (N, gain, P))
    mus, taus = np.array(_PAIRS).T
    margins = -np.linalg.eigvalsh(adaptation.form(N_, K_, P_, mus, taus))[:, -1]
    size = float(solution.peak) + adaptation.shape.kept[0] * mus  # the largest V over |eps|^2
    mu, tau = map(Fraction, _PAIRS[int(np.argmax(margins / size))])
    proved = definite.positive(exact(-adaptation.form(N, gain, P, mu, tau)))
    return Decay(adaptation, growth, solution.P, mu, tau) if proved else None


@dataclass(frozen=True)
class LimitedInjection(Flow):
    """The search for a Lyapunov function of an observer with gains `K` (n) and a limited injection, valid for all
    partial derivatives of b. The candidates are the functions V of the `decays` of the linear error. `error`: the error
    dynamics if all of y - C z were injected."""

    how: str = "one function"
    K: tuple[Fraction, ...] = ()
    decays: tuple[Decay, ...] = ()
    close: ClassVar[tuple[float, float]] = (CLOSE, CLOSE)

    @property
    def missing(self) -> Reason:
        """The reason why there is no proof at any theta: the linear error is not proved to decay."""
        return because("the linear core is not shown to decay")

    def obstacle(self, states: Sequence[Any]) -> Reason:
        """Return the reason why there is no proof at the declared theta. `states`: the symbols of the z_j in this
        text."""
        return self.unstable(states) or because("no function is found for all slopes in their ranges")

    def at(self, theta: Fraction, alpha: Fraction = Fraction(0)) -> DecayProof | None:
        """Return a proof of V' <= -alpha V at the gain theta, by the first candidate V for which it holds; None for
        none."""
        holding = (one for one in self.decays if self._holds(one, theta, alpha))
        return next(filter(None, (self._proof(one, theta, alpha) for one in holding)), None)

    @cached_property
    def _weights_at_theta(self) -> Decay | None:
        """The proof whose V decreases at the declared theta,
        preferably V' <= -alpha V with alpha > 0, or None."""
        return self._weights(self.theta, self._most * SLOW) or self._weights(self.theta)

    @property
    def _most(self) -> Fraction:
        slowest = [self.theta * one.adaptation.decay for one in self.decays if one.adaptation.shape.most]
        return min([Fraction(-2 * self.slowest[0]), *slowest])

    def _weights(self, theta: Fraction, alpha: Fraction = Fraction(0)) -> Decay | None:
        return next((one for one in self.decays if self._holds(one, theta, alpha)), None)

    def _thetas(self, by: Decay) -> Callable[[Fraction], bool]:
        return lambda theta: self._holds(by, theta)

    def _alphas(self, by: Decay) -> Callable[[Fraction], bool]:
        return lambda alpha: self._holds(by, self.theta, alpha)

    def _holds(self, one: Decay, theta: Fraction, alpha: Fraction = Fraction(0)) -> bool:
        e = self.error.at(theta).floats
        forms = self._values(one, (e.M, e.G, e.H), float(theta), float(alpha))
        return all(np.linalg.eigvalsh(form).max() < -_SMALL * np.abs(form).max() for form in forms)

    def _proof(self, one: Decay, theta: Fraction, alpha: Fraction) -> DecayProof | None:
        if one.adaptation.shape.most and alpha > theta * one.adaptation.decay:
            return None
        e = self.error.at(theta)
        M, G, H = (np.array(fractions(A), dtype=object).reshape(A.shape) for A in (e.M, e.G, e.H))
        forms = self._values(one, (M, G, H), theta, alpha)
        if not all(definite.positive(fmpq_mat(rational(-form).tolist())) for form in forms):
            return None
        P = self._P(one)
        S = () if few_corners(len(P), len(H)) else tuple(map(_multiplier, (np.array(P) @ G / theta).T))
        return DecayProof(theta, alpha, Weights(P, S), {"mu": one.mu, "tau": one.tau})

    def _P(self, one: Decay) -> tuple[tuple[Fraction, ...], ...]:
        t = [one.growth**i / unit for i, unit in enumerate(self.error.units)]
        return tuple(tuple(t[i] * x * t[j] for j, x in enumerate(row)) for i, row in enumerate(one.P))

    def _values(self, one: Decay, parts: tuple[Array, Array, Array], theta: Any, alpha: Any) -> list[Array]:
        """Return the matrices that prove V' <= -alpha V if all are negative, from `parts` M, G and H
        of the error dynamics, for the V of `one`; in floats or rationals, as theta and alpha are."""
        number, way, (M, G, H) = type(theta), one.adaptation, parts
        N, G, a, (n, m) = M / theta, G / theta, alpha / theta, G.shape
        P, mu, tau = np.array([[number(x) for x in row] for row in self._P(one)]), number(one.mu), number(one.tau)
        K = np.array([number(unit * k) for unit, k in zip(self.error.units, self.K, strict=True)])

        def forms(N: Array) -> tuple[Array, Array]:
            """Return the matrices behind the saturation or dead zone, and where all of the error is injected."""
            return way.form(N, K, P, mu, tau) + a * way.value(P, mu), N.T @ P + P @ N + a * P

        if few_corners(n, m):
            return [form for d in product((-1, 1), repeat=m) for form in forms(N + (G * np.array(d)) @ H)]
        steps = [forms(N + np.outer(g, h)) for g, h in zip(G.T, H, strict=True)]
        S = [number(_multiplier(v)) for v in (P @ G).T]
        each = zip(forms(N), zip(*steps, strict=True), strict=True)
        return [_bounded(form, [after - form for after in afters], H, S) for form, afters in each]


def _bounded(form: Array, by: Sequence[Array], reads: Array, S: Sequence[Any]) -> Array:
    """Return `form` plus, for each v of `by` and row h of `reads`, S
    h h' + v v'/S, which is at least d (v h' + h v'), |d| <= 1."""
    for move, read, s in zip(by, reads, S, strict=True):
        h = np.append(read, 0 * read[: len(form) - len(read)])
        v = move @ h - h * (h @ move @ h) / 2
        form = form + s * np.outer(h, h) + np.outer(v, v) / s
    return form


def _multiplier(v: Array) -> Fraction:
    return Fraction(max(1, round(float(np.linalg.norm(v.astype(float))) * 2**_BITS)), 2**_BITS)


def limited_injection(
    chain: Integrators, theta: float, K: np.ndarray, decays: tuple[Decay, ...], numbers: Any
) -> LimitedInjection | Nothing:
    """Return the search for a Lyapunov function of an observer with gains K (n) and a limited injection, on a chain of
    integrators at `theta`; or the reason why there is none. `numbers`: the observer's arguments for certificates."""
    reason = obstacle(chain.form)
    if reason:
        return Nothing(reason)
    near_z = nominal_units(chain)
    if isinstance(near_z, Nothing):
        return near_z
    units, gains = [unit / near_z[0] for unit in near_z], [Fraction(k) for k in K.tolist()]
    form, scale = chain.form, from_form(chain.form, units)
    error = inclusion(form, plain(form), companion(np.array(gains)), as_matrix(form, gains), scale, units, numbers)
    if isinstance(error, Nothing):
        return error
    return LimitedInjection(error, Fraction(theta), K=tuple(gains), decays=decays)


REFERENCE = (
    "Astolfi, Alessandri, Zaccarian, Stubborn and dead-zone redesign for nonlinear observers and filters, "
    "IEEE TAC 66(2) (2021)"
)
EQUATION = "w' = A w + c(w, u) + diag(theta, .., theta^n) K {}, |sat(e)| <= sqrt(sigma), e = y - w_1"
LEVEL = "sigma' = theta (-decay sigma + r e^2)"


def limited(
    name: str,
    shape: Shape,
    form: Form,
    *,
    theta: Any,
    decay: Any,
    r: Any,
    sigma: Any,
    poles: Sequence[complex] | None,
    gains: Sequence[float] | np.ndarray | None,
    initial: Mapping[str, float] | Sequence[float] | None,
    accept: Iterable[str],
    theorem: Theorem,
) -> Observer:
    """Return the observer `dead_zone` or `stubborn`, by its `name` and `shape`, with the checks `NAME.core`,
    `.convergence` and `.theta`; other arguments as of these observers. Raises: `Refuted`; `BadPoles`; `NotHurwitz`;
    `BadGain`."""
    accept = demand_form(name, form, accept, requires=integrators)
    high, chain = high_gain_parameter(theta), integrators(name, form)
    K = injection_gains(name, poles, gains, chain.n)
    slow, fast, start = positive("decay", decay), positive("r", r), real("sigma", sigma)
    if not 0 <= start < np.inf:
        raise BadGain(f"sigma = {sigma!r}", "must be a finite number, not negative: the square of the first level")
    least = slow * 1e-3
    if shape.below:
        if not fast < slow:
            raise BadGain(f"r = {r!r}", f"must be below decay = {slow:g}, or nothing would ever be injected")
        least = (slow + fast) / 2  # so that r is below it at every tuning
    adaptation = Adaptation(shape, Fraction(slow), Fraction(fast))
    return observer_on(
        chain,
        name,
        parts=(_part(chain, chain.field(initial, high.initial[0]), K, high.initial[0], shape, slow, start),),
        gains=(
            high,
            gain("decay", slow, least, slow, "lambda, theta times it is the rate at which sigma decays"),
            gain("r", fast, 1e-3 * fast, fast if shape.below else 1e3 * fast, "weight of e^2 in sigma'"),
        ),
        w=sym("state", "w", chain.n),
        theorem=theorem,
        equations=(EQUATION.format(shape.text), LEVEL, f"K = {listed(K)}"),
        reference=REFERENCE,
        claims=lambda: _claims(name, chain, high.initial[0], K, adaptation),
        accepted=accept,
        traces=("sigma",),
    )


def _claims(name: str, chain: Integrators, theta: float, K: np.ndarray, adaptation: Adaptation) -> tuple[Check, ...]:
    proofs = decays(adaptation, K)
    numbers = {"theta": theta, "decay": adaptation.decay, "r": adaptation.r, "gains": K}
    sought, core = limited_injection(chain, theta, K, proofs, numbers), core_check(name, adaptation, proofs, numbers)
    if isinstance(sought, Nothing):
        return core, *unknown_checks(name, theta, sought.reason)
    return core, *convergence_checks(name, chain.form, sought, numbers)


def _part(chain: Integrators, w: Field, K: np.ndarray, theta: float, shape: Shape, decay: float, start: float) -> Ode:
    level = sym("gain", "theta")
    square = scalar("sigma", start, low=0.0, unit="y^2", meaning=f"square of the level of the {shape.name}")

    def nonlinear(values: Mapping[str, Any], u: Any, y: Any, valid: Any) -> dict[str, Any]:
        w_, sigma = values["w"], values["sigma"]
        e, most = valid * (y - chain.offset(u) - w_[0]), ca.sqrt(ca.fmax(sigma, 0))
        sat = ca.fmin(ca.fmax(e, -most), most)
        return {
            "w": shifted(w_) + chain.nonlinear(w_, u) + sym("derived", "K", chain.n) * shape.injected(e, sat),
            "sigma": level * (sym("gain", "r") * (e * e) - sym("gain", "decay") * sigma),
        }

    n = chain.n
    labels = tuple(f"theta^{i} K_{i}" if i > 1 else "theta K_1" for i in range(1, n + 1))
    return Ode(
        (w, square),
        nonlinear,
        derived=(Field("K", (0.0,) * n, labels=labels, meaning="observer gain"),),
        frozen={"sigma": (0.0 if shape.below else HUGE,)},  # all of the error is injected
        tune=(Block("observer gain", {Place("derived", "K"): scaled(K, level)}),),
        core=theta * np.block([[companion(K), np.zeros((n, 1))], [np.zeros((1, n)), -decay]]),
    )
