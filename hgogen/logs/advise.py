"""Observer gains without a log: from the ranges, the noise, the sampling period and a wanted settling time, with a
trial of other values of theta.

    theta = tau_n/T,   exp(-tau) (1 + tau + .. + tau^(n-1)/(n-1)!) = 1/100 at tau = tau_n

T is the wanted time: n poles at -theta reduce the response to an initial error to a hundredth within T. Without T,
theta is that of the starting gains. The settling time is measured on the trial without noise. The effect of noise is
the RMS difference between two runs, with and without noise, in the steady part.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Any

import numpy as np

from hgogen import observers as every
from hgogen.analysis.evidence import Grounds
from hgogen.call import CallableStep
from hgogen.check import refuted
from hgogen.errors import BadArgument, HgogenError
from hgogen.form import Form
from hgogen.logs.tune import first_of, observers_named, reasons, thetas
from hgogen.modelfiles.tuning import First, everywhere
from hgogen.reading.given import positive, requires_any_plant, requires_switches
from hgogen.run import native
from hgogen.run.campaign import Workers
from hgogen.run.metrics import metrics
from hgogen.signal import differences
from hgogen.starting import Scale, gains_of, longest, scale, two_digits
from hgogen.system import System
from hgogen.trial import OrnsteinUhlenbeck, Trial, Truth, feeds, first_memory, run_feeds, sample_times, simulate
from hgogen.which_forms import Row

SETTLED_SHARE = 0.01  # of the initial error


@dataclass(frozen=True)
class Tried:
    """The results of a step with the gain `theta` on a trial; `settling`: the requested settling time for which this
    theta would be proposed."""

    json_keys = "theta settled noise"

    theta: Annotated[float, "the gain theta; 0 for an observer without one"]
    settled: Annotated[float | None, "time to settle from the start of the trial; null: never"]
    noise: Annotated[Mapping[str, float], "RMS that noise alone makes of the estimate, by state"]
    settling: float


@dataclass(frozen=True)
class Advised:
    """The proposed gains of an observer; `first`: its form and step; `tried`: the results of several values of theta on
    the trial, including the proposed one (one entry for an observer without theta, none without a trial)."""

    name: Annotated[str, "name of the tuning"]
    first: First
    theta: Annotated[float | None, "the gain theta; null for an observer without one"]
    certified: Annotated[float | None, "the least theta for which convergence is proved; null where none is"]
    tried: Annotated[tuple[Tried, ...], "values of theta on the trial"]
    sigma: Annotated[Mapping[str, float], "standard deviation of a sample, by output"] = field(default_factory=dict)

    @property
    def table(self) -> Mapping[str, Any]:
        """The tuning as a table of a model file, from which the step of `first` can be built again."""
        return self.first.table(self.name)

    @property
    def own(self) -> Tried | None:
        """The result on the trial of the proposed theta; None without a trial."""
        return next((one for one in self.tried if one.theta == (self.theta or 0.0)), None)

    @property
    def settles(self) -> Tried | None:
        """The result on the trial of the smallest theta that settles; None if none does."""
        settling = (one for one in self.tried if one.settled is not None)
        return min(settling, key=lambda one: one.theta, default=None)

    @property
    def sentence(self) -> str:
        """Return a sentence that compares the proposed theta with the smallest certified and the smallest settling one;
        empty without theta."""
        if self.theta is None:
            return ""
        parts = []
        if self.certified is not None:
            ratio = self.certified / self.theta
            far = f"not certified, {ratio:.2g} times below" if ratio >= 1 else "certified, as it is above"
            parts.append(f"is {far} the smallest certified theta, {self.certified:.3g}")
        if self.tried and self.own is not None and self.own.settled is None:
            first, other = self.settles, ", nor does another that was tried"
            if first is not None:
                other = f", {first.theta:g} is the first that does, by --settling {first.settling:.4g} (settling=)"
            parts.append(f"does not settle in the trial{other}")
        return f"theta {self.theta:g} of {self.name} {', and '.join(parts)}" if parts else ""


class NoneAdmitted(BadArgument):
    """The error for a plant that admits none of the requested observers."""


@requires_any_plant
@requires_switches
def advise(
    plant: System,
    *,
    dt: float | tuple[float, float] | None = None,
    noise: Mapping[str, float] | None = None,
    settling: float | None = None,
    observers: Iterable[str] | None = None,
    trial: Trial | None = None,
    rows: Iterable[Row] | None = None,
    deep: bool = False,
    jobs: int | None = 1,
    each: Callable[[str], None] = lambda what: None,
) -> tuple[tuple[Advised, ...], dict[str, str]]:
    """Return the proposed gains of the observers that a plant admits, and the reasons why other observers have none, by
    name.

    `dt`: the sampling period, or the shortest and the longest, by default that of the starting gains; `noise`: the
    standard deviation of a sample by output, by default 1 % of half its range; `settling`: the requested settling time
    of an initial error; `trial`: a trial on which other values of theta are run, such as `hg.proposed_trial(plant)`;
    `rows`: the candidate forms, by default those that the plant is in, the slow ones only if `deep`; `jobs`: processes,
    None for one for each core; `each(what)` is called after every observer.

    Raises: `UnknownObserver`; `NoneAdmitted`; `BadGain` for a dt, a noise or a time that is not positive; `BadTrial`.
    """
    candidates, names = tuple(everywhere(plant, deep=deep) if rows is None else rows), observers_named(observers, plant)
    problem = _Problem(dt, noise, None if settling is None else positive("settling", settling), trial, candidates)
    done: dict[str, Advised | str] = {}
    for _, form in problem.usable[:1]:
        problem.scale(form)  # raises for an invalid period or noise before any process starts
    for name, one in Workers(problem, jobs).results(_Problem.of, names):
        done[name] = one
        each(name)
    advised = tuple(one for name in names if isinstance(one := done[name], Advised))
    refused = {name: one for name in names if isinstance(one := done[name], str)}
    if not advised:
        raise NoneAdmitted(f"plant {plant.name!r}", f"admits none of these observers: {reasons(refused)}")
    return advised, refused


@dataclass(frozen=True)
class _Problem:
    dt: float | tuple[float, float] | None
    noise: Mapping[str, float] | None
    settling: float | None
    trial: Trial | None
    rows: tuple[Row, ...]
    truths: dict[float, Truth] = field(default_factory=dict)  # the simulated plant by period, shared by all theta

    @property
    def usable(self) -> list[tuple[Row, Form]]:
        return [(row, row.form) for row in self.rows if row.form is not None and not refuted(row.form.checks)]

    def scale(self, form: Form) -> Scale:
        base = scale(form, self.dt and longest(self.dt), self.noise)
        if self.settling is None:
            return base
        return replace(base, theta=max(1.0, two_digits(tau(max(base.blocks)) / self.settling)))

    def of(self, name: str) -> tuple[str, Advised | str]:
        refusals = ["the plant is in none of its forms"]
        for row, form in self.usable:
            base = self.scale(form)
            try:
                first = _first(name, row, base, self.dt)
            except HgogenError as error:
                refusals.append(str(error))
                continue
            return name, (first if isinstance(first, str) else self._tried(first, row, base))
        return name, refusals[:2][-1]

    def _tried(self, first: First, row: Row, base: Scale) -> Advised:
        observer = getattr(every, first.observer)
        reads = gains_of(observer, replace(base, theta=2 * base.theta)) != first.starting.gains
        values = sorted({base.theta, *thetas(base.theta, base.dt)}) if reads and self.trial else [base.theta]
        every_theta = []
        for theta in values:
            try:
                one = first if theta == base.theta else _first(first.observer, row, replace(base, theta=theta), self.dt)
            except HgogenError:
                continue
            if isinstance(one, First) and self.trial is not None:
                settled, rms = self._on(one.step, self.trial, base.noise)
                every_theta.append(Tried(theta if reads else 0.0, settled, rms, tau(max(base.blocks)) / theta))
        proofs = (proof for check in first.step.observer.checks for proof in check.proofs)
        bounds = (getattr(proof.fact, "theta", None) for proof in proofs if isinstance(proof, Grounds))
        certified = next((float(bound) for bound in bounds if bound is not None), None)
        reported_theta = base.theta if reads else None
        return Advised(first.observer, first, reported_theta, certified, tuple(every_theta), base.noise)

    def _on(
        self, step: CallableStep, trial: Trial, noise: Mapping[str, float]
    ) -> tuple[float | None, dict[str, float]]:
        """Return the settling time of a step on the trial, None for never, and the RMS of the estimate
        due to noise alone, by state; `noise`: the standard deviation of a sample by output."""
        if step.dt not in self.truths:
            plant, times = step.observer.form.system.declared, sample_times(step, trial)
            self.truths[step.dt] = simulate(plant, trial, step.dt, times)
        truth, start = self.truths[step.dt], first_memory(step, trial)
        clean, noisy = (
            next(run_feeds(step, feeds(step, replace(trial, noise=each), truth, (0,)), start, native.engine()))
            for each in ({}, {name: OrnsteinUhlenbeck(sigma) for name, sigma in noise.items()})
        )
        steady = truth.t >= trial.steady_from - 1e-9
        with np.errstate(all="ignore"):
            rms = np.sqrt(np.mean(differences(step.states, noisy.x, clean.x)[steady] ** 2, axis=0))
        names = [s.name for s in step.states]
        return metrics(step, clean).responses[0].settled, dict(zip(names, rms.tolist(), strict=True))


def tau(n: int) -> float:
    """Return the time, in units of 1/theta, in which n poles at -theta reduce the response to an initial error to a
    hundredth, by bisection."""
    low, high = 0.0, 100.0 + 10 * n
    while high - low > 1e-9:
        middle = (low + high) / 2
        remaining = math.exp(-middle) * sum(middle**k / math.factorial(k) for k in range(n))
        low, high = (middle, high) if remaining > SETTLED_SHARE else (low, middle)
    return high


def _first(name: str, row: Row, numbers: Scale, dt: float | tuple[float, float] | None) -> First | str:
    gains = gains_of(getattr(every, name), numbers)
    return gains if isinstance(gains, str) else first_of(name, row, gains, dt or numbers.dt, {})
