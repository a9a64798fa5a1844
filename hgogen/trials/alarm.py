"""Whether the alarm of an adaptive theta can feed itself: the innovation at the largest theta, over the threshold.

    ratio = (mean of I_d with theta held at 2 theta_1, nothing wrong) / gamma_0

At 2 theta_1 the estimate is noisy, and the prediction that the innovation judges starts from it. Where noise alone
then keeps I_d above gamma_0, an alarm never ends. Up to 1 theta comes back; from about 5 on it does not; between, the
noise decides. (Of a logistic mu, the centre stands for gamma_0.)
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hgogen.call import CallableStep
from hgogen.calling.samples import Engine
from hgogen.emit import layout
from hgogen.emit.saved import sealed
from hgogen.signal import resting
from hgogen.trial import Trial, noisy, simulate
from hgogen.trials.metrics import Summary

SEEDS = 3  # a mean over many windows varies little from seed to seed
ITSELF = 1.0  # the ratio above which the alarm can feed itself


def ratio(step: CallableStep, trial: Trial, engine: Engine, seeds: Sequence[int]) -> float | None:
    """Median over at most three of the seeds, from the second half of the trial without its jumps; None for a theta
    without innovation. The step itself is left alone.

    Raises: `BadTrial`.
    """
    nominal = {gain.name: gain.initial for gain in step.layout.gains}
    threshold = nominal.get("gamma_0", nominal.get("centre"))
    if threshold is None:
        return None
    plant, quiet = step.observer.form.system, replace(trial, jumps=(), steady=None)
    truth = simulate(plant, quiet, step.dt)
    pinned = replace(step)  # with a memory of its own
    pinned.tune(rate=0)  # theta never decays
    start = _at_the_peak(pinned, quiet)
    means = []
    for seed in seeds[:SEEDS]:
        pinned.restore(start)
        y = pinned.arriving(noisy(plant, truth, quiet, [seed])[0])
        innovation = pinned.run(truth.u, y, engine).traces["innovation"]
        means.append(np.mean(innovation[len(innovation) // 2 :]))
    return float(np.median(means)) / float(threshold[0])


def complaints(each: Iterable[Summary]) -> Iterator[str]:
    """A sentence for every trial with an innovation in which theta does not come back."""
    for one in each:
        if one.latched and one.alarm_ratio is not None:
            fed = one.alarm_ratio > ITSELF
            advice = "; lower theta_1 or Q, or raise gamma_0" if fed else ", so it needs more time between the events"
            yield (
                f"trial {one.trial!r}: theta does not come back in {one.latched} of {one.seeds} seeds: "
                f"alarm ratio {one.alarm_ratio:.2g}{advice}"
            )


def _at_the_peak(step: CallableStep, trial: Trial) -> bytes:
    """The state before the first call, but the estimate (that of each predictor too) the truth, theta at its peak."""
    form = step.observer.form
    values: dict[Any, Any] = {s: trial.start[s.name] for s in form.system.states} | form.system.nominal
    values |= {u: resting(u) for u in form.system.inputs}
    state = np.frombuffer(layout.fresh(step, step.real), layout.state_type(step, step.real)).copy()
    state["z"] = z = [float(expression.subs(values)) for expression in form.to_form]
    state["theta"] = max(field.high[0] for field in step.layout.state if field.name == "theta")
    if any(group.name == "predictor" for group in step.layout.groups):
        state["predictor"]["z"] = z
    return sealed(step, step.real, state.tobytes())
