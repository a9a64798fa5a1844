"""Gains from inputs to the error of an observer: noise in the running step; L2 and ISS gains in continuous time.

    noise    |e_i| <= beta_ij for noise of at most 1 in each sample of output j, whatever its course, at every call
    L2       |C e|_2 <= mu |v|_2 + a term of the start, v the inputs in units of their sizes, |.|_2 over all time
    ISS      |e_i| is at most its bound in the end, while each input is at most its size, of any course

All hold at the observer's own theta, whatever the slopes of b in their ranges, while the plant keeps to its ranges and
no guard acts. The first is for the step that runs. The others are for continuous time and observers of a constant
injection: for design, and to compare with the literature.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache

import numpy as np
import sympy as sp

from hgogen.analysis.ranges import fixed_parameters
from hgogen.analysis.scaling import heads, sizes_of_used
from hgogen.certificates.contraction import contraction, method_phrase, proved_check
from hgogen.check import Check, ClaimId, Verdict
from hgogen.form import Form
from hgogen.observer import Observer, asks_an_observer
from hgogen.prove.convergence import DecayProof, Flow
from hgogen.prove.inclusion import NO_SCALES, Inclusion, Nothing, Uncertain, state_row
from hgogen.prove.inequality import Contracts, Inputs, driven_by_multipliers
from hgogen.prove.quadratic import floats, inverse_root, rational, stacked
from hgogen.prove.questions import (
    Driven,
    InputBound,
    error_inclusion,
    input_bound,
    l2_bound,
    step_input_bound,
    theta_of,
)
from hgogen.reading.given import Each, in_order, names_of, sizes
from hgogen.rigor.box import exact
from hgogen.rigor.outward import number
from hgogen.sentence import Reason, Sentence, Up, because
from hgogen.step import Step, demand_step


@dataclass(frozen=True)
class NoiseGain:
    """The proved ultimate effect of noise on a step. `gains`: by (state of the form, output), the largest error of the
    state for noise of at most 1 in each sample of the output; the effects of several outputs add up. `check`:
    OBSERVER.noise."""

    gains: Mapping[tuple[str, str], float]
    check: Check

    def bound(self, state: str, noise: Mapping[str, float]) -> float:
        """Return the ultimate bound of a state's error for noise of at most these sizes, by name of the output: the sum
        of gain times size. Quantisation of samples with step q is noise of q/2. Raises: `BadNames` for an unknown state
        or output; `BadGain` for an invalid size."""
        states, outputs = (tuple(dict.fromkeys(names)) for names in zip(*self.gains, strict=True))
        in_order("state", {state: None}, states, default=dict.fromkeys(states))
        each = zip(outputs, sizes("noise", noise, outputs), strict=True)
        return sum(self.gains[state, output] * float(most) for output, most in each)


def noise_gain(step: Step) -> NoiseGain | Nothing:
    """Return the ultimate bounds of errors under noise v, of a step that is proved to contract; or the reason why there
    are none: no contraction, or a chain whose gains contain parameters.

    By |e+|_P^2 <= (1 - alpha dt) |e|_P^2 + dt sum_k lambda_k v_k^2 with sum_k lambda_k <= alpha, the set |e|_P <= 1 is
    invariant for |v_k| <= 1, and a larger error approaches it. Raises: `NoSolver` without Clarabel; `NoStep`.
    """
    demand_step(step, "noise_gain")
    known = contraction(step)
    if known.proof is None or not known.proof.alpha:
        return Nothing(known.checks[0].reason)
    return _noise_gain(step.observer, step.code.rule, step.dt, known.proof)


@lru_cache(maxsize=32)
def _noise_gain(observer: Observer, rule: str, dt: float, proof: Contracts) -> NoiseGain | Nothing:
    error, form = proof.steps.error, observer.form
    scales = error.scales(proof.steps.theta)
    if scales is None:
        return Nothing(NO_SCALES)
    bounds: dict[tuple[int, int], InputBound] = {}
    for i, field in enumerate(error.layout.picks):
        for j in heads(form):
            one = step_input_bound(proof, Inputs.of(proof.step.ends(j)), state_row(scales, field))
            if one is None:
                return Nothing(because("no bound is found of what noise of {y} does", y=form.system.outputs[j]))
            bounds[i, j] = one
    outputs = [output.name for output in form.system.outputs]
    gains = {(state, output): 0.0 for state in form.names for output in outputs}  # 0 for an output that is not injected
    gains |= {(form.names[i], outputs[j]): number(one.bound)[1] for (i, j), one in bounds.items()}
    at = method_phrase(observer, rule, dt)
    claim = f"{at}, noise of at most 1 at each sample moves the estimate by a bounded amount, whatever its course"
    phrases = [
        Sentence.of("{state} by at most {gain} for 1 of {output}", state=state, gain=Up(gain, 3), output=output)
        for (state, output), gain in gains.items()
    ]
    reason = because("{said}, in {arithmetic} arithmetic", said=phrases, arithmetic=proof.step.arithmetic)
    written = [{"state": i + 1, "output": j + 1, "bound": one} for (i, j), one in bounds.items()]
    facts = {"method": rule, "dt": Fraction(dt), "bounds": written}
    return NoiseGain(gains, proved_check(observer, "noise", claim, reason, error, facts))


_FIX, _NO_V = "Validate by trials.", because("no V is found for all slopes in their ranges")
_WHILE = Sentence.of("while the estimate keeps to its outer box; in rational arithmetic")


@dataclass(frozen=True)
class L2Gain:
    """A proved bound `gain` of the L2 gain from noise and disturbances to the error, None where none is proved;
    `check`: OBSERVER.l2_gain."""

    gain: float | None
    check: Check

    def __str__(self) -> str:
        return str(self.check)


@dataclass(frozen=True)
class IssGain:
    """The proved ultimate `bounds` of the errors by state of the form (input-to-state stability), {} where none are
    proved; `check`: OBSERVER.iss_gain."""

    bounds: Mapping[str, float]
    check: Check

    def __str__(self) -> str:
        return str(self.check)


@asks_an_observer
def l2_gain(observer: Observer, *, noise: Each = None, disturbance: Each = None, of: Each = None) -> L2Gain:
    """Return a proved bound mu of the L2 gain, |C e|_2 <= mu |v|_2 + a term of the initial error, from inputs v to the
    error e of an observer with a constant injection gain, in continuous time, at its theta.

    Args: `noise`: the size of noise that counts as 1, by output, by default 0; `disturbance`: the same for disturbances
    in the rate of a state of the plant, by name; `of`: the weight in C of a state of the form, by name, by default 1.
    Raises: `NoSolver` without Clarabel; `BadNames`, `BadGain` for an invalid size.
    """
    claim = "in continuous time, the L2 gain from noise and disturbances to the error has a bound"
    weights = sizes("of", of, observer.form.names, 1.0)
    known = _known(observer, noise, disturbance)
    if not any(weights):
        known = because("nothing is counted of the error")
    if isinstance(known, Reason):
        return L2Gain(None, _unknown(observer, "l2_gain", claim, known))
    rows = [state_row(known.scales, k) * w for k, w in zip(known.error.layout.picks, rational(weights), strict=True)]
    driven = Driven(known.driven, stacked(rows, len(known.scales)))
    bound = l2_bound([driven], inverse_root(floats(rational(known.falls.weights.P))))
    if bound is None:
        return L2Gain(None, _unknown(observer, "l2_gain", claim, _NO_V))
    reason = because("at most {mu}, {inputs}, {while_}", mu=Up(bound.mu, 3), inputs=known.phrases, while_=_WHILE)
    facts = {
        "noise": known.noise,
        "beside": known.disturbances,
        "counts": weights,
        "mu": bound.mu,
        "V": bound.weights,
    }
    return L2Gain(number(bound.mu)[1], proved_check(observer, "l2_gain", claim, reason, known.error, facts))


@asks_an_observer
def iss_gain(observer: Observer, *, noise: Each = None, disturbance: Each = None) -> IssGain:
    """Return proved ultimate bounds of the errors of the form's states under inputs v, in continuous time, by V' <=
    -alpha V + sum_k lambda_k v_k^2 with sum_k lambda_k <= alpha. The bounds are proportional to the inputs.

    Args: `noise`: the largest noise of each output, by name; `disturbance`: the largest disturbance in the rate of a
    state of the plant, by name; both vary arbitrarily, 0 by default. Raises: `NoSolver` without Clarabel; `BadNames`,
    `BadGain` for an invalid size.
    """
    claim = "in continuous time, under noise and disturbances the error of every state comes to a bound"
    known = _known(observer, noise, disturbance)
    if isinstance(known, Reason):
        return IssGain({}, _unknown(observer, "iss_gain", claim, known))
    W, fields = inverse_root(floats(rational(known.falls.weights.P))), known.error.layout.picks
    q, fastest = known.driven.B.shape[1], known.falls.alpha
    rows = (state_row(known.scales, k) for k in fields)
    each = [input_bound(lambda alpha: (driven_by_multipliers(known.driven, alpha),), W, q, c, fastest) for c in rows]
    bounds = [one for one in each if one]
    if len(bounds) < len(each):
        return IssGain({}, _unknown(observer, "iss_gain", claim, _NO_V))
    by_name = dict(zip(observer.form.names, bounds, strict=True))
    phrases = [Sentence.of("{state} to {bound}", state=x, bound=Up(one.bound, 3)) for x, one in by_name.items()]
    reason = because("{said}, {inputs}, {while_}", said=phrases, inputs=known.phrases, while_=_WHILE)
    facts = {"noise": known.noise, "beside": known.disturbances, "bounds": bounds}
    gains = {x: number(one.bound)[1] for x, one in by_name.items()}
    return IssGain(gains, proved_check(observer, "iss_gain", claim, reason, known.error, facts))


# --- what enters


@dataclass(frozen=True, eq=False)
class _Known:
    """The `error` at `theta`, whose decay `falls` proves; `driven`: its system with q
    inputs, first the outputs' noise of the sizes `noise` (p), then the `disturbances`,
    each as added to z' (n); `scales` (N) of e; `phrases`: the inputs in words."""

    error: Inclusion
    theta: Fraction
    falls: DecayProof
    driven: Uncertain
    noise: tuple[Fraction, ...]
    disturbances: tuple[tuple[Fraction, ...], ...]
    scales: tuple[Fraction, ...]
    phrases: tuple[Sentence, ...]


def _known(observer: Observer, noise: Each, disturbance: Each) -> _Known | Reason:
    form, system = observer.form, observer.form.system
    noises = sizes_of_used(form, sizes("noise", noise, names_of(system.outputs)))
    disturbed = sizes("disturbance", disturbance, names_of(system.declared.states))
    error = error_inclusion(observer)
    if isinstance(error, Nothing):
        return error.reason
    if not any((*noises, *disturbed)):
        return because("nothing enters the error: that of the start decays, to nothing")
    theta = theta_of(observer)
    scales, flow = error.scales(theta), Flow(error, theta)
    if scales is None:
        return NO_SCALES
    rows = _disturbance_rows(form, disturbed)
    if isinstance(rows, Reason):
        return rows
    if flow.fastest is None or not flow.fastest.alpha:
        return flow.obstacle(form.states)
    columns = [-error.lifted(scales) @ rational(row) for row in rows]
    phrases = _phrases("noise of {y} of {size}", system.outputs, noises)
    phrases += _phrases("{y}' disturbed by {size}", system.declared.states, disturbed)
    noisy = error.at(theta).driven_by(rational(np.diag(noises))[:, [size > 0 for size in noises]])
    driven = noisy.disturbed(stacked(columns, len(scales)).T)
    return _Known(error, theta, flow.fastest, driven, tuple(noises), rows, scales, tuple(phrases))


def _phrases(pattern: str, signals: tuple[sp.Symbol, ...], sizes: list[Fraction]) -> list[Sentence]:
    pairs = zip(signals, sizes, strict=True)
    return [Sentence(pattern, (("y", str(signal)), ("size", float(size)))) for signal, size in pairs if size]


def _disturbance_rows(form: Form, sizes: list[Fraction]) -> tuple[tuple[Fraction, ...], ...] | Reason:
    """Return, for each disturbance of nonzero size of a plant state's rate, what
    it adds to z' (n), z the states of the form; or why that is no number."""
    states, columns = form.system.declared.states, list[tuple[Fraction, ...]]()
    for x, size in zip(states, sizes, strict=True):
        if not size:
            continue
        rows = [exact(sp.sympify(sp.diff(z, x)).xreplace(fixed_parameters(form))) for z in form.entry]
        if not all(row.is_Rational for row in rows):
            return because("{x}' enters the form's rows by slopes that are no numbers", x=str(x))
        columns.append(tuple(Fraction(row.p, row.q) * size for row in rows))
    return tuple(columns)


def _unknown(observer: Observer, fact: str, claim: str, why: Reason) -> Check:
    return Check(ClaimId(observer.name, fact), claim, Verdict.UNKNOWN, why, fix=_FIX)
