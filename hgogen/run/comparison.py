"""Runs of one trial compared: several observers, C and Python, float and double, and a run with its theorem.

Observers have the same truth, noise and sampling period, and the same first estimate:

    convergence    time to settle after the start and after each jump, the median of the seeds (`metrics.criterion`)
    steady error   its root mean square over the trial's steady part, the median of the seeds
    peaking        the largest rise of the error of each state after an event, over its range, of all seeds: max |e(t)|
                   until the next event less the |e| at the event itself, which the start or the jump causes
    cost           operations of one call, bytes of the state
    proved         the bound of each state's error, where a model declares bounds of noise and the like, and the largest
                   error over all seeds from the time on at which the bound holds

The range of a state: `metrics.ranges`.

C and Python evaluate the same operations in double precision. Until theta first rises they can differ by rounding only.
While theta is high the gain amplifies small differences, so from there on the times to settle are compared. A run in
float, as on small firmware, is compared with one in double:

    difference = max over samples of |x_float - x_double|, over the width of the state's range, else over its peak

without samples at which one of them is not a finite number.

For an observer with a covariance, V should decrease from call to call, and S stay within bounds:

    V_k = e' S e,   S = P^-1, e = z - z(x) after the sample k;   scaled S = theta^g Delta^-1 S Delta^-1

Theorems on such observers have V' <= -alpha V and alpha_1 <= scaled S <= alpha_2 with unknown constants (Boizot,
Busvelle, Gauthier, Automatica 46 (2010)); g is 1 where theta scales Q alone, else 0 (`scaling`). `lyapunov_decay`
measures these constants on one trajectory of a trial without noise, which proves nothing. Once V has fallen to a
millionth since an event, rounding and the step's truncation error dominate, and the later samples are omitted.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Annotated, ClassVar

import casadi as ca
import numpy as np

from hgogen.call import CallableStep
from hgogen.certificates.error_bound import ErrorBound
from hgogen.emit.cost import Cost, cost
from hgogen.errors import HgogenError
from hgogen.form import Form
from hgogen.graph import to_casadi
from hgogen.run.metrics import Interventions, Metrics, crossings, interventions, median, metrics, ranges
from hgogen.run.samples import Engine, Run
from hgogen.run.uncertainty import uncertainty
from hgogen.sentence import Encoded
from hgogen.signal import Signal, with_times
from hgogen.signal import differences as short_way
from hgogen.trial import Trajectory, Trial, elapsed, feeds, first_memory, sample_times, simulate, try_out


@dataclass(frozen=True, eq=False)
class Measured(Encoded):
    """The results of an observer on a trial over several seeds: times to settle, errors, peaks, cost; `first`: the
    trajectory of the first seed."""

    json_keys = "name observer method settled rms peak clamped acted proved worst unproved *cost"

    name: Annotated[str, "name of its tuning"]
    observer: Annotated[str, "name of the observer"]
    method: Annotated[str, "method of its step"]
    states: tuple[Signal, ...]
    settled: Annotated[tuple[float | None, ...], "median time to settle after each event; null: never"]
    rms: Annotated[Mapping[str, float], "steady error by state, the median of the seeds"]
    peak: Annotated[Mapping[str, float], "largest rise of the error after an event, over the state's range"]
    clamped: Annotated[int, "samples outside the box after the first 5%"]
    cost: Cost
    first: Trajectory
    acted: Annotated[Interventions, "when guards acted on the estimate, over all seeds"]
    proved: Annotated[Mapping[str, float], "the bound by state that has one"] = field(default_factory=dict)
    worst: Annotated[
        Mapping[str, float | None],
        "by state, the largest error of all seeds from when on the bound holds; null where the trial ends before",
    ] = field(default_factory=dict)
    unproved: Annotated[str, "what is not known of the bounds, and why"] = ""


def measured(
    name: str,
    step: CallableStep,
    trial: Trial,
    engine: Engine,
    seeds: Sequence[int],
    tick: Callable[[], None],
    known: ErrorBound | None = None,
) -> Measured:
    """Return the results of a step over several seeds; `name`: the name of the step's tuning; `tick` is called after
    each seed; `known`: the proved error bounds of the step."""
    each = []
    for trajectory in try_out(step, trial, engine, seeds):
        each.append(trajectory)
        tick()
    per_seed = [metrics(step, one) for one in each]
    names, events = [s.name for s in step.states], zip(*(one.responses for one in per_seed), strict=True)
    peak = np.max([error_rises(one) for one in each], axis=0) / ranges(step, each[0])
    return Measured(
        name=name,
        observer=step.observer.name,
        method=step.code.rule,
        states=step.states,
        settled=tuple(median(response.settled for response in event) for event in events),
        rms={state: float(np.median([m.rms[state] for m in per_seed])) for state in names},
        peak=dict(zip(names, map(float, peak), strict=True)),
        clamped=sum(m.clamped for m in per_seed),
        cost=cost(step),
        first=each[0],
        acted=sum((interventions(step, one.status, one.truth.t) for one in each), Interventions(runs=0)),
        proved=known.bounds if known else {},
        worst=largest_errors(step.states, each, known) if known else {},
        unproved=str(known.missing) if known else "",
    )


def error_rises(trajectory: Trajectory) -> np.ndarray:
    """Return the peaking of each state (n): the largest rise of |error| above its value at an event, over all
    events."""
    error, t = np.abs(trajectory.error), trajectory.truth.t
    begins = [k for k in np.searchsorted(t, np.array(trajectory.trial.events) - 1e-9) if k < len(t)]
    largest: np.ndarray = (np.maximum.reduceat(error, begins) - error[begins]).max(axis=0)
    return largest


@dataclass(frozen=True)
class BoundedError:
    """The largest error of a state in a trial, and the proved error bound, which holds from the time `after` an event
    on."""

    state: Annotated[str, "the state"]
    unit: Annotated[str, "its unit"]
    bound: Annotated[float, "what is proved of its error"]
    after: Annotated[float, "how long after an event the bound holds"]
    worst: Annotated[float | None, "largest error from then on; null where the trial ends before"]


def bounded_errors(states: Sequence[Signal], trajectory: Trajectory, known: ErrorBound) -> tuple[BoundedError, ...]:
    """Return the largest error and the proved bound of each state that has a bound (`known`); none if the time from
    which bounds hold is unknown."""
    if known.settles is None:
        return ()
    t, events = trajectory.truth.t, np.asarray(trajectory.trial.events)
    last = events[np.searchsorted(events, t, side="right") - 1]
    holds = t - last >= known.settles
    rows = []
    for k, state in enumerate(states):
        if state.name in known.bounds:
            worst = float(np.abs(trajectory.error[holds, k]).max()) if holds.any() else None
            rows.append(BoundedError(state.name, state.unit, known.bounds[state.name], known.settles, worst))
    return tuple(rows)


def largest_errors(
    states: Sequence[Signal], each: Sequence[Trajectory], known: ErrorBound
) -> Mapping[str, float | None]:
    """Return by name the largest error over all trajectories of each state with a proved bound; None where all
    trajectories end before the bound holds."""
    rows = [one for trajectory in each for one in bounded_errors(states, trajectory, known) if one.worst is not None]
    return {name: max((one.worst or 0.0 for one in rows if one.state == name), default=None) for name in known.bounds}


ROUNDING = 1e-11  # of the trajectory's peak: about 1e3 operations a step with errors of 1e-16, damped in 1e2 steps
COARSE = 1e-3  # of a state's range: more than rounding causes without amplification


@dataclass(frozen=True)
class Agreement(Encoded):
    """The difference between a step's results in C and in Python on one trial and seed, relative to each state's peak.

    Times to settle may differ by one sample, because an error that just touches the band may lie on either side of it.
    """

    json_keys = "trial seed until before after settled dt agreed"

    trial: Annotated[str, "name of the trial"]
    seed: Annotated[int, "seed of its noise"]
    until: Annotated[float, "time of the first rise of theta through 1.5, else the end (s)"]
    before: Annotated[float, "largest difference until then"]
    after: Annotated[float, "largest difference from then on"]
    settled: Annotated[tuple[tuple[float | None, float | None], ...], "times to settle after each event: C, Python (s)"]
    dt: Annotated[float, "sampling period (s)"]

    @property
    def agreed(self) -> bool:
        """Whether the differences between C and Python are due to rounding alone."""
        c, python = np.array(self.settled, dtype=float).reshape(-1, 2).T  # NaN where never
        return self.before <= ROUNDING and np.allclose(c, python, rtol=0, atol=1.5 * self.dt, equal_nan=True)


def agreement(c: tuple[Trajectory, Metrics], python: tuple[Trajectory, Metrics], dt: float) -> Agreement:
    """Return the difference between C and Python, each given by its trajectory and metrics on the same trial and seed;
    `dt`: the period."""
    (mine, measured), (other, expected) = c, python
    peak = np.maximum(np.abs(other.x).max(axis=0), np.finfo(float).tiny)
    difference = (np.abs(short_way(mine.truth.states, mine.x, other.x)) / peak).max(axis=1)
    rises = crossings(other.traces["theta"]) if "theta" in other.traces else np.array([], int)
    first = int(rises[0]) if len(rises) else len(difference)
    return Agreement(
        trial=mine.trial.name,
        seed=mine.seed,
        until=float(other.truth.t[min(first, len(difference) - 1)]),
        before=float(difference[:first].max(initial=0.0)),
        after=float(difference[first:].max(initial=0.0)),
        settled=tuple((a.settled, b.settled) for a, b in zip(measured.responses, expected.responses, strict=True)),
        dt=dt,
    )


@dataclass(eq=False)
class Disagree(HgogenError):
    """The error for results in C and in Python that differ by more than rounding."""

    status: ClassVar[int] = 1
    failed: tuple[Agreement, ...]

    def __str__(self) -> str:
        worst = max(self.failed, key=lambda one: one.before)
        return (
            f"C and Python disagree in trial {worst.trial!r}, seed {worst.seed}: {worst.before:.1e} of the peak until "
            f"t = {worst.until:g}, times to settle {worst.settled}; check the compiler's flags (no -ffast-math)"
        )


@dataclass(frozen=True)
class Difference:
    """The difference between the estimates of a state in float and in double, over the same samples."""

    state: Annotated[str, "the state"]
    unit: Annotated[str, "its unit"]
    largest: Annotated[float, "largest difference"]
    t: Annotated[float, "time of the largest difference"]
    share: Annotated[float, "the difference over the scale"]
    scale: Annotated[float, "width of the state's range, or its peak"]
    of: Annotated[str, "range or peak: what the scale is"]
    status: Annotated[int, "samples whose status differs, in the whole run"]


def differences(states: Sequence[Signal], single: Run, double: Run) -> tuple[Difference, ...]:
    """Return the difference of each state between two runs over the same samples: `single` in float, `double` in double
    precision."""
    status = int(np.count_nonzero(single.status != double.status))
    each = []
    for signal in states:
        gap = np.abs(signal.difference(single[signal.name], double[signal.name]))
        size = np.abs(double[signal.name])
        gap, peak = np.where(np.isfinite(gap), gap, 0.0), float(size[np.isfinite(size)].max(initial=0.0))
        width = signal.interval[1] - signal.interval[0]
        scale, kind = (width, "range") if signal.bounded else (peak, "peak")
        at = int(np.argmax(gap))
        share = float(gap[at]) / scale if scale else float(gap[at] > 0)
        each.append(
            Difference(signal.name, signal.unit, float(gap[at]), float(single.t[at]), share, scale, kind, status)
        )
    return tuple(each)


def precision_warnings(each: Sequence[Difference], unit: str) -> Iterator[str]:
    """Yield a sentence for each state whose estimate in float differs from that in double by more than rounding, and
    one for statuses that differ; `unit`: the unit of time."""
    for one in each:
        if one.share > COARSE:
            yield (
                f"in float, {one.state} is {one.share:.2g} of its {one.of} from double at {one.t:.4g} {unit}: scale "
                "the states to numbers of one size, lower the gains, or take double"
            )
    if each and each[0].status:
        yield f"in float, samples whose status is another than in double: {each[0].status}"


SMALL = 1e-6  # share of the largest V since an event, below which samples are omitted


@dataclass(frozen=True)
class LyapunovDecay:
    """The decay of the Lyapunov function V = e' S e, S the inverse of the covariance, on a trial without noise."""

    trial: Annotated[str, "name of the trial"]
    ratio: Annotated[float | None, "largest V_(k+1)/V_k; null where no V is above what rounding leaves"]
    time: Annotated[float | None, "after which time that is"]
    calls: Annotated[int, "number of calls"]
    eigenvalues: Annotated[tuple[float, float], "least and largest eigenvalue of scaled S along the trial"]

    def sentence(self, unit: str) -> str:
        """Return the decay of V = e' S e as a sentence in one line; `unit`: the unit of the model's time."""
        low, high = self.eigenvalues
        bounds = f"scaled S has eigenvalues from {low:.3g} to {high:.3g}"
        if self.ratio is None:
            return f"shown in trials, not proved: {bounds}"
        most = (
            f"V = e' S e at a call is at most {self.ratio:.6g} times that at the call before (after {self.time:g} "
            f"{unit})"
        )
        return f"shown in trials, not proved: without noise {most}; {bounds}"


def lyapunov_decay(step: CallableStep, trial: Trial, engine: Engine | None = None) -> LyapunovDecay | None:
    """Return how V = e' P^-1 e changes from call to call on a trial without noise: its largest ratio and its time. None
    for a step without a covariance P, for a bank of observers, and where P is not positive definite. Raises: as
    `hgogen.trial.try_out`."""
    known = uncertainty(step)
    if known is None or known.members is not None:
        return None
    noiseless = replace(trial, noise={})
    truth = simulate(step.observer.form.system.declared, noiseless, step.dt, sample_times(step, trial))
    (fed,) = feeds(step, noiseless, truth, (0,))
    step.restore(first_memory(step, noiseless))
    run = step.run(u=fed.u, y=step.arriving(fed.y), engine=engine, dt=elapsed(step, truth))
    form = step.observer.form
    P, e = _in_form(form, run, truth.x, with_times(form.system.inputs, fed.u, run.times, run.t))
    there = np.isfinite(P).all(axis=(1, 2)) & np.isfinite(e).all(axis=1)
    P, e = P[there], e[there]
    scaling, peak = known.part.scaling, known.part.theta.peak
    theta = run.traces.get("theta", np.full(len(there), peak))[:, None]
    Delta = (theta ** -(np.array(scaling.states, dtype=float) + scaling.gauge / 2))[there]  # with theta^(-g/2)
    spread = np.linalg.eigvalsh(P * Delta[:, :, None] * Delta[:, None, :])
    if not (spread.size and (spread > 0).all()):
        return None
    V = np.einsum("ki,ki->k", e, np.linalg.solve(P, e[:, :, None])[:, :, 0])
    pairs = list(_ratios(truth.t[there], V, trial))
    ratio, time = max(pairs) if pairs else (None, None)
    return LyapunovDecay(trial.name, ratio, time, len(pairs), (float(1 / spread.max()), float(1 / spread.min())))


def _in_form(form: Form, run: Run, truth: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return P (N, n, n) and e (N, n) in the form's coordinates,
    from a run and the true plant states (N, n)."""
    x, inputs = ca.SX.sym("x", len(run.names)), ca.SX.sym("u", u.shape[1])
    symbols = dict(zip(form.system.declared.states, ca.vertsplit(x), strict=True))
    symbols |= dict(zip(form.system.inputs, ca.vertsplit(inputs), strict=True)) if u.shape[1] else {}
    symbols |= {p: float(value) for p, value in form.system.nominal.items()}
    z = ca.vertcat(*to_casadi(form.entry, symbols))
    there = ca.Function("z", [x, inputs], [ca.densify(z), ca.densify(ca.jacobian(z, x))])
    estimate, wide = map(np.array, there(run.x.T, u.T))
    slope = wide.reshape(form.n, len(u), -1).swapaxes(0, 1)
    P = run.covariance
    assert P is not None  # the step has one
    error = short_way(form.states, estimate.T, np.array(there(truth.T, u.T)[0]).T)
    return slope @ P @ slope.swapaxes(1, 2), error


def _ratios(t: np.ndarray, V: np.ndarray, trial: Trial) -> Iterator[tuple[float, float]]:
    """Yield V_(k+1)/V_k and the time t_k of the calls between
    two events of the trial, until V (N,) is small."""
    for begin, end in pairwise((*trial.events, np.inf)):
        here = (t >= begin - 1e-9) & (t < end - 1e-9)
        level, time = V[here], t[here]
        large = level > SMALL * level.max(initial=0.0)
        fallen = int(np.argmin(large)) if not large.all() else len(level)
        for k in range(min(fallen, len(level) - 1)):
            yield float(level[k + 1] / level[k]), float(time[k])
