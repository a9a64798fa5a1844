"""How far noise of the samples moves an estimate, as the step runs: bounds that hold for every course of the noise."""

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache

from hgogen.analysis.spare import heads
from hgogen.certificates.contraction import claimed, contraction, running
from hgogen.check import Check
from hgogen.observer import Observer
from hgogen.prove.bounded_theta import Nothing
from hgogen.prove.contracting import Contracts, Steps
from hgogen.prove.inclusion import NO_SCALES, of_state
from hgogen.prove.inequality import Inputs
from hgogen.prove.questions import InputBound, of_step
from hgogen.reading.named import in_order, sizes
from hgogen.rigor.outward import number
from hgogen.sentence import Sentence, Up, because
from hgogen.step import Step, demand_step


@dataclass(frozen=True)
class NoiseGain:
    """`gains`: by the name of a state of the form and of an output, how far the estimate of the one goes at most for
    noise of at most 1 in the samples of the other, in their units; of several outputs the shares add. `check`: that it
    is so, OBSERVER.noise."""

    gains: Mapping[tuple[str, str], float]
    check: Check

    def bound(self, state: str, noise: Mapping[str, float]) -> float:
        """How far the estimate of a state goes at most for noise of at most these sizes, by output: their shares add.
        Rounding of samples to steps of q is noise of q/2.

        Raises: `BadNames` for a state or an output that there is not; `BadGain` for what is no size.
        """
        states, outputs = (tuple(dict.fromkeys(names)) for names in zip(*self.gains, strict=True))
        in_order("state", {state: None}, states, default=dict.fromkeys(states))
        each = zip(outputs, sizes("noise", noise, outputs), strict=True)
        return sum(self.gains[state, output] * float(most) for output, most in each)


def noise_gain(step: Step) -> NoiseGain | Nothing:
    """What noise does to the estimate of a step that is proved to contract; or why that is not known: of one that is
    not, or whose chain has gains that are no numbers.

    From elsewhere a bound is approached: where it is reached V = |e|_P^2 is 1, and what V is above that falls by
    alpha dt of itself at each call.

    Raises: `NoSolver` without cvxpy; `NoStep`.
    """
    demand_step(step, "noise_gain")
    known = contraction(step)
    if known.steps is None or known.proof is None or not known.proof.alpha:
        return Nothing(known.checks[0].reason)
    return _noise_gain(step.observer, step.code.rule, step.dt, known.steps, known.proof)


@lru_cache(maxsize=32)
def _noise_gain(observer: Observer, rule: str, dt: float, steps: Steps, proof: Contracts) -> NoiseGain | Nothing:
    error, form = steps.error, observer.form
    scales = error.scales(steps.theta)
    if scales is None:
        return Nothing(NO_SCALES)
    bounds: dict[tuple[int, int], InputBound] = {}
    for i, field in enumerate(error.layout.picks):
        for j in heads(form):
            one = of_step(steps, proof.h, Inputs.of(steps.at(proof.h).ends(j)), of_state(scales, field), proof.alpha)
            if one is None:
                return Nothing(because("no bound is found of what noise of {y} does", y=form.system.outputs[j]))
            bounds[i, j] = one
    outputs = [output.name for output in form.system.outputs]
    gains = {(state, output): 0.0 for state in form.names for output in outputs}  # of one that enters nowhere
    gains |= {(form.names[i], outputs[j]): number(one.bound)[1] for (i, j), one in bounds.items()}
    at = running(observer, rule, dt)
    claim = f"{at}, noise of at most 1 at each sample moves the estimate by a bounded amount, whatever its course"
    said = [
        Sentence.of("{state} by at most {gain} for 1 of {output}", state=state, gain=Up(gain, 3), output=output)
        for (state, output), gain in gains.items()
    ]
    reason = because("{said}, in {arithmetic} arithmetic", said=said, arithmetic=steps.at(proof.h).arithmetic)
    written = [{"state": i + 1, "output": j + 1, **one.written} for (i, j), one in bounds.items()]
    facts = {"method": rule, "dt": Fraction(dt), "bounds": written}
    return NoiseGain(gains, claimed(observer, "noise", claim, reason, error, facts))
