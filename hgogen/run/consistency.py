"""Is an observer consistent: are its errors as large as it says, and is nothing left in them that a model could know?

    NIS  = mean of e_k^2/s_k over the N samples of an output:  N NIS is chi-square with N degrees of freedom
    NEES = mean of x~' P^-1 x~ over samples with a truth:      N NEES/tau is so with n N/tau

e the innovation, s the variance that the observer takes it to have; x~ the error of the n states whose truth is known,
P their covariance, tau how many errors tell as much as one, since errors follow each other also where all is right.
Whiteness is tested of e/sqrt(s). Source: Y. Bar-Shalom, X. R. Li, T. Kirubarajan, "Estimation with applications to
tracking and navigation" (2001), 5.4.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from hgogen.reading.given import Misfit, asks
from hgogen.run.prediction import Prediction, rms
from hgogen.run.samples import BadShape, Run
from hgogen.run.whiteness import Whiteness, alike, quantile, whiteness

Array = np.ndarray
_LATER = (
    "if it is only until the estimate has settled, give --initial or --burn-in, else fit the parameters by `hgogen "
    "fit` or the gains by `hgogen tune`"
)
WORSE = 1.05  # times the error of another prediction: worse


@dataclass(frozen=True)
class OfOutput:
    """The innovations of one output."""

    output: Annotated[str, "the output"]
    count: Annotated[int, "number of innovations"]
    rms: Annotated[float, "their RMS value"]
    nis: Annotated[float | None, "normalised innovation squared, the mean of e^2/s; null without a covariance"]
    band: Annotated[tuple[float, float] | None, "ends of its 95 % band"]
    outside: Annotated[float | None, "share beyond 2 sigma"]
    whiteness: Annotated[Whiteness | None, "test of whiteness; null for too few"]


@dataclass(frozen=True)
class OfStates:
    """The errors of states whose truth is known."""

    states: Annotated[tuple[str, ...], "the states"]
    count: Annotated[int, "number of samples"]
    alike: Annotated[float, "how many errors tell as much as one that is independent"]
    nees: Annotated[float, "mean normalised estimation error squared; the number of states where P is right"]
    band: Annotated[tuple[float, float], "ends of its 95 % band"]


@dataclass(frozen=True)
class Consistency:
    """The consistency of a run."""

    outputs: Annotated[tuple[OfOutput, ...], "the innovations of each output"]
    states: Annotated[OfStates | None, "the errors of states whose truth is known; null without truth or covariance"]

    def sentences(self) -> tuple[str, ...]:
        """What is not as the observer says."""
        said = []
        for one in self.outputs:
            if one.nis is not None and one.band is not None and not one.band[0] <= one.nis <= one.band[1]:
                factor = math.sqrt(one.nis)
                said.append(
                    f"innovations of {one.output} are {factor:.3g} times as large as the observer takes them to be: "
                    f"{'R, Q or both are too small, or the model is wrong' if one.nis > 1 else 'R or Q is too large'}"
                )
            if one.whiteness is not None and not one.whiteness.white:
                said.append(
                    f"innovations of {one.output} are not white (Ljung-Box {one.whiteness.statistic:.3g}, limit "
                    f"{one.whiteness.limit:.3g}): they can be predicted, so that the model, the gains, or the time of "
                    "an input or sensor is off"
                )
        states = self.states
        if states is not None and not states.band[0] <= states.nees <= states.band[1]:
            factor = math.sqrt(states.nees / len(states.states))
            said.append(
                f"by the truth, errors of {', '.join(states.states)} are {factor:.3g} times as large as the covariance "
                f"says: it is {'too sure' if factor > 1 else 'too careful'}"
            )
        return tuple(said)


@asks(Run, "a run, as step.run gives it")
def consistency(run: Run, truth: Mapping[str, Array] | None = None) -> Consistency:
    """Of a run of a step; `truth` (N,) of states by name, NaN where it is not known. Raises: `BadShape`, `Misfit`."""
    if truth is not None and not isinstance(truth, Mapping):
        raise Misfit("consistency, truth=", truth, "a mapping from states to arrays")
    e, variances = run.innovations, run.variances
    if e is None:
        return Consistency((), None)
    s = [None] * e.shape[1] if variances is None else list(variances.T)
    each = tuple(_of_output(name, *pair) for name, pair in zip(run.outputs, zip(e.T, s, strict=True), strict=True))
    return Consistency(each, _of_states(run, truth or {}))


def _of_output(name: str, e: Array, s: Array | None) -> OfOutput:
    there = np.isfinite(e) & ((s > 0) if s is not None else True)
    e, count = e[there], int(there.sum())
    size = rms(e)
    if s is None or not count:
        return OfOutput(name, count, size, None, None, None, whiteness(e))
    normed = e / np.sqrt(s[there])
    band = (quantile(0.025, count) / count, quantile(0.975, count) / count)
    root = rms(normed)
    nis = root * root  # which is infinite, and not an error, where it is too large
    return OfOutput(name, count, size, nis, band, float(np.mean(abs(normed) > 2)), whiteness(normed))


def _of_states(run: Run, truth: Mapping[str, Array]) -> OfStates | None:
    names, P = tuple(truth), run.covariance
    for name, values in truth.items():
        if np.shape(values) != run[name].shape:
            raise BadShape(f"truth of {name} of shape {np.shape(values)}", f"must have shape {run[name].shape}")
    if P is None or not names:
        return None
    index = [run.names.index(name) for name in names]
    errors = np.column_stack([run[name] - np.asarray(truth[name], dtype=float) for name in names])
    P = P[:, index][:, :, index]
    sigma = np.sqrt(np.maximum(np.diagonal(P, axis1=1, axis2=2), 0.0))
    there = np.isfinite(errors).all(axis=1) & np.isfinite(P).all(axis=(1, 2)) & (sigma > 0).all(axis=1)
    if not there.any():
        return None
    scaled, scale = errors[there] / sigma[there], sigma[there, :, None] * sigma[there, None, :]
    inverse = np.linalg.pinv(P[there] / scale, hermitian=True)
    values, n = np.einsum("ki,kij,kj->k", scaled, inverse, scaled), len(names)
    tau = min(alike(values), float(len(values)))
    freedom = n * len(values) / tau
    low, high = (n * quantile(p, freedom) / freedom for p in (0.025, 0.975))
    return OfStates(names, len(values), tau, float(values.mean()), (low, high))


def no_better(predictions: Sequence[Prediction]) -> Iterator[str]:
    """A sentence for each output that is predicted worse than by copying."""
    for output in dict.fromkeys(one.output for one in predictions):
        rows = [one for one in predictions if one.output == output and one.copying is not None]
        if rows and not any(one.copying for one in rows):
            yield f"{output} stands still in the whole record, so that copying it errs by 0: give a record that moves"
            continue
        worse = [one for one in rows if one.model > WORSE * (one.copying or 0.0)]
        if worse:
            steps = f"{', '.join(str(one.ahead) for one in worse)} step{'s' * (worse[-1].ahead != 1)} ahead"
            errors = ", ".join(f"{one.model:.3g} for {one.copying:.3g}" for one in worse)
            yield f"{output}: worse than copying at {steps}, by RMS errors of {errors}; {_LATER}"
