"""Statistics of residuals and of measured noise: whiteness, consistency with a covariance, standard deviations.

    N (N + 2) sum_k r_k^2/(N - k)   is chi-square with K degrees of freedom

for the first K autocorrelations r_k of N white numbers (Ljung and Box). Residuals of a model that is too simple are
correlated: tau of them have the information of one independent residual, tau = 1 + 2 sum_k r_k over the first r_k > 0.

    sigma = 1.4826 median |e|,   c = 1.345 sigma,   rho(e) = c^2 (sqrt(1 + (e/c)^2) - 1),   psi = rho'

Outliers do not change the median as long as they are fewer than half. An estimate that minimises the sum of rho has the
covariance of least squares with the variance E psi^2/(E psi')^2, so the influence of a residual is psi(e)/E psi'.

Quantiles of chi-square are Wilson and Hilferty's (1931), within 4 % from 5 degrees of freedom on. Sources: G. M. Ljung,
G. E. P. Box, Biometrika 65 (1978); T. Soederstroem, P. Stoica, System Identification (1989), chapter 11; Huber, Robust
Statistics (1981), chapters 5 and 7.

An observer is consistent if its errors agree with its covariance and its innovations are white:

    NIS  = mean of e_k^2/s_k over the N samples of an output:  N NIS is chi-square with N degrees of freedom
           by the median: (1.4826 median |e_k|/sqrt(s_k))^2, for the samples that are no outliers
           sum of e' S^-1 e over N, of N samples of all outputs together: so is N NIS
    NEES = mean of x~' P^-1 x~ over samples with a truth:      N NEES/tau is so with n N/tau

e is the innovation at the prediction, s its variance by the observer, S the covariance of those of a call, x~ the
error of the n states whose truth is known, P their covariance. tau counts correlated errors as above, since errors are
correlated also in a consistent observer. The test of whiteness uses e/sqrt(s). Source: Y. Bar-Shalom, X. R. Li, T.
Kirubarajan, "Estimation with applications to tracking and navigation" (2001), 5.4.

A log without excitation gives the noise and the thresholds of an innovation:

    sigma: standard deviation about a straight line;  tau: the lag at which the autocorrelation falls to 1/e
    s^2 = (2/N) (1 + 2 sum_{k=1..N-1} (1 - k/N) rho^k),  rho = exp(-2 dt/tau),  N = d/dt
    gamma_0 = sigma^2 d (1 + k s),  k = 6.5,  gamma_1 = 2 gamma_0

sigma^2 d is the mean of the innovation of pure noise, s its standard deviation over that mean. The innovation exceeds
the mean alone, the threshold of Boizot, Busvelle, Gauthier 2010, four times in ten; gamma_0 is above it by k s.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from hgogen.errors import BadArgument
from hgogen.reading.given import Misfit, requires
from hgogen.run.prediction import Prediction, rms
from hgogen.run.samples import BadShape, Run
from hgogen.sentence import Encoded

Array = np.ndarray
LAGS = 20  # most autocorrelations in a test of whiteness
LEAST = 3  # fewest samples for each of these
NORMAL = {0.025: -1.959963985, 0.95: 1.644853627, 0.975: 1.959963985}  # quantiles of the normal distribution
OF_MEDIAN = 1.4826  # sigma over the median of |e|
CORNER = 1.345  # c over sigma, with an efficiency of 95 % for normal residuals
ROUNDING = 1e-9  # of the scale of an output: smaller residuals are rounding
FEW = 4.0  # NIS over that by the median, above which few samples make it
WRONG = 5.0  # in units of sigma: larger residuals are outliers


@dataclass(frozen=True)
class Whiteness(Encoded):
    """The result of the Ljung-Box test for white noise: its `statistic`, the `limit` that white noise exceeds in one of
    20 cases, and the number of `lags`."""

    json_keys = "test statistic limit lags white"

    statistic: Annotated[float, "the statistic of the correlations"]
    limit: Annotated[float, "what one in 20 white sequences exceeds"]
    lags: Annotated[int, "number of correlations"]

    @property
    def test(self) -> str:
        """The name of the statistical test."""
        return "Ljung-Box"

    @property
    def white(self) -> bool:
        """Whether the statistic is within the limit for white noise."""
        return self.statistic <= self.limit


def whiteness(e: Array) -> Whiteness | None:
    """Return the Ljung-Box test of a sequence e (N,) for white noise; None for a short or constant sequence."""
    N = len(e)
    lags = min(LAGS, N // LEAST)
    r = correlations(e, lags)
    if not lags or r is None:
        return None
    statistic = N * (N + 2) * float(np.sum(r**2 / (N - np.arange(1, lags + 1))))
    return Whiteness(statistic, quantile(0.95, lags), lags)


def correlations(e: Array, lags: int) -> Array | None:
    """Return the autocorrelations at the lags 1 to `lags` (at most N - 1) of a sequence e (N,); None for a constant
    sequence."""
    e = np.ldexp(e, -np.frexp(np.abs(e).max(initial=0.0))[1])  # scaled by a power of two, so that no square overflows
    centred = e - e.mean() if len(e) else e
    power = float(centred @ centred)
    if not power > 0:
        return None
    spectrum = np.abs(np.fft.rfft(centred, 2 * len(e))) ** 2  # padded to twice the length, against circular correlation
    return np.asarray(np.fft.irfft(spectrum)[1 : min(lags + 1, len(e))] / power)


def quantile(p: float, freedom: float) -> float:
    """Return the p-quantile of chi-square with `freedom` degrees of freedom, p a key of `NORMAL`."""
    spread = 2 / (9 * freedom)
    return float(freedom * max(0.0, 1 - spread + NORMAL[p] * math.sqrt(spread)) ** 3)


def integrated_autocorrelation_time(residuals: Array) -> float:
    """Return the integrated autocorrelation time tau = 1 + 2 sum_k r_k of residuals (N,), in samples: N correlated
    residuals have the information of N/tau independent ones. The sum ends before the first r_k <= 0."""
    r = correlations(residuals, len(residuals))
    return 1.0 if r is None else 1.0 + 2.0 * float(r[np.cumsum(r <= 0) == 0].sum())


def deviation(residuals: Array) -> float:
    """Return the robust standard deviation 1.4826 median |e| of residuals e (N,), in units of their output's scale."""
    return max(OF_MEDIAN * float(np.median(np.abs(residuals))), ROUNDING)


def corner(residuals: Array) -> float:
    """Return the corner c = 1.345 sigma of the pseudo-Huber loss rho(e) = c^2 (sqrt(1 + (e/c)^2) - 1) for residuals
    (N,)."""
    return CORNER * deviation(residuals)


def influence(residuals: Array, c: float) -> Array:
    """Return psi(e)/E psi' (N,) for residuals e (N,): psi = rho' with rho the pseudo-Huber loss of the corner `c`."""
    growth = 1 + (residuals / c) ** 2
    share = float(np.mean(growth**-1.5))
    return np.asarray(residuals / np.sqrt(growth) / share)


_LATER = (
    "if this is only until the estimate has settled, give --initial or --burn-in; otherwise fit the parameters by "
    "`hgogen fit` or tune the gains by `hgogen tune`"
)
WORSE = 1.05  # times the error of another prediction: worse


@dataclass(frozen=True)
class OutputConsistency:
    """Statistics of the innovations e of one output, with variance s by the observer: RMS, mean of e^2/s with its 95 %
    band, whiteness."""

    output: Annotated[str, "the output"]
    count: Annotated[int, "number of innovations"]
    rms: Annotated[float, "their RMS value"]
    nis: Annotated[float | None, "normalised innovation squared, the mean of e^2/s; null without a covariance"]
    band: Annotated[tuple[float, float] | None, "ends of its 95 % band"]
    outside: Annotated[float | None, "share beyond 2 sigma"]
    whiteness: Annotated[Whiteness | None, "test of whiteness; null for too few"]
    median: Annotated[float | None, "NIS by the median of e^2/s, which outliers hardly move; null without it"] = None

    def __str__(self) -> str:
        error = f"{self.output}: {self.count} innovations, RMS {self.rms:.3g}"
        if self.nis is None or self.band is None:
            return f"{error}, no covariance"
        return f"{error}, NIS {self.nis:.3g}, 95 % band {self.band[0]:.3g} to {self.band[1]:.3g}"

    @property
    def cause(self) -> str:
        """The likely cause of a NIS outside of its 95 % band, in words."""
        if self.nis is None or self.nis <= 1:
            return "R or Q is too large"
        if self.median is None or self.nis <= FEW * self.median:
            return "R, Q or both are too small, or the model is wrong"
        return (
            f"few samples are the cause, since by the median they are {math.sqrt(self.median):.3g} times as large. For "
            f"outliers, use hgogen tune --robust and a gate, gate = {{{self.output} = 0.999}}"
        )


@dataclass(frozen=True)
class JointConsistency:
    """The statistic of the innovations e of all outputs together, with covariance S by the observer: the sum of e' S^-1
    e, divided by the number of samples of all outputs, with its 95 % band."""

    outputs: Annotated[tuple[str, ...], "the outputs"]
    freedom: Annotated[int, "degrees of freedom, the number of samples of all outputs"]
    nis: Annotated[float, "normalised innovation squared, e' S^-1 e for each degree of freedom"]
    band: Annotated[tuple[float, float], "ends of its 95 % band"]


@dataclass(frozen=True)
class StateConsistency:
    """Statistics of the estimation errors e of the states whose truth is known, with covariance P by the observer: the
    mean of e' P^-1 e with its 95 % band."""

    states: Annotated[tuple[str, ...], "the states"]
    count: Annotated[int, "number of samples"]
    alike: Annotated[float, "how many errors tell as much as one that is independent"]
    nees: Annotated[float, "mean normalised estimation error squared; the number of states where P is right"]
    band: Annotated[tuple[float, float], "ends of its 95 % band"]


@dataclass(frozen=True)
class Consistency:
    """Statistics that compare a run's innovations (by output) and estimation errors with the covariance of the
    observer."""

    outputs: Annotated[tuple[OutputConsistency, ...], "the innovations of each output"]
    states: Annotated[
        StateConsistency | None, "the errors of states whose truth is known; null without truth or covariance"
    ]
    joint: Annotated[JointConsistency | None, "those of several outputs together; null without a covariance"] = None

    def __str__(self) -> str:
        return "\n".join((*map(str, self.outputs), *self.sentences()))

    def sentences(self, explained: bool = False) -> tuple[str, ...]:
        """Return a sentence for each statistic that contradicts the observer's covariance; without those on innovations
        if a fault of the log has `explained` them."""
        sentences = []
        for one in () if explained else self.outputs:
            if one.nis is not None and one.band is not None and not one.band[0] <= one.nis <= one.band[1]:
                factor = math.sqrt(one.nis)
                sentences.append(
                    f"innovations of {one.output} are {factor:.3g} times as large as the observer assumes: {one.cause}"
                )
            if one.whiteness is not None and not one.whiteness.white:
                sentences.append(
                    f"innovations of {one.output} are not white (Ljung-Box {one.whiteness.statistic:.3g}, limit "
                    f"{one.whiteness.limit:.3g}): each depends on those before it, since the model, "
                    "the gains, or the time of an input or sensor is wrong"
                )
        joint, marginal = self.joint, not sentences and not explained
        if joint is not None and marginal and not joint.band[0] <= joint.nis <= joint.band[1]:
            sentences.append(
                f"innovations of {', '.join(joint.outputs)} together are {math.sqrt(joint.nis):.3g} times as large as "
                "the observer assumes, and each alone is not: R, Q or the model gives them a wrong correlation"
            )
        states = self.states
        if states is not None and not states.band[0] <= states.nees <= states.band[1]:
            factor = math.sqrt(states.nees / len(states.states))
            sentences.append(
                f"by the truth, errors of {', '.join(states.states)} are {factor:.3g} times as large as by the "
                f"covariance, which is too {'small' if factor > 1 else 'large'}"
            )
        return tuple(sentences)


@requires(Run, "a run, as step.run gives it")
def consistency(run: Run, truth: Mapping[str, Array] | None = None) -> Consistency:
    """Return whether the innovations and errors of a run agree with the observer's covariance; `truth`: (N,) by state,
    NaN where it is unknown. Raises: `BadShape`, `Misfit`."""
    if truth is not None and not isinstance(truth, Mapping):
        raise Misfit("consistency, truth=", truth, "a mapping from states to arrays")
    e, variances = run.innovations, run.variances
    if e is None:
        return Consistency((), None)
    s = [None] * e.shape[1] if variances is None else list(variances.T)
    each = tuple(map(_output_consistency, run.outputs, e.T, s))
    return Consistency(each, _states_consistency(run, truth or {}), _joint_consistency(run.outputs, e, run.joint))


def _output_consistency(name: str, e: Array, s: Array | None) -> OutputConsistency:
    there = np.isfinite(e) & ((s > 0) if s is not None else True)
    e, count = e[there], int(there.sum())
    size = rms(e)
    if s is None or not count:
        return OutputConsistency(name, count, size, None, None, None, whiteness(e))
    normed = e / np.sqrt(s[there])
    band = (quantile(0.025, count) / count, quantile(0.975, count) / count)
    root = rms(normed)
    nis = root * root  # infinite, and not an error, on overflow
    outside, middle = float(np.mean(abs(normed) > 2)), float(np.median(abs(normed))) * OF_MEDIAN
    return OutputConsistency(name, count, size, nis, band, outside, whiteness(normed), middle * middle)


def _joint_consistency(outputs: tuple[str, ...], e: Array, S: Array | None) -> JointConsistency | None:
    if S is None or len(outputs) < 2:
        return None
    there = np.isfinite(e) & (np.diagonal(S, axis1=1, axis2=2) > 0)
    sigma = np.sqrt(np.where(there, np.diagonal(S, axis1=1, axis2=2), 1.0))
    normed, both = np.where(there, e, 0.0) / sigma, there[:, :, None] & there[:, None, :]
    correlation = np.where(both, S / (sigma[:, :, None] * sigma[:, None, :]), np.eye(len(outputs)))
    freedom = int(there.sum())
    if not freedom:
        return None
    values = np.einsum("ki,kij,kj->k", normed, np.linalg.pinv(correlation, hermitian=True), normed)
    low, high = (quantile(p, freedom) / freedom for p in (0.025, 0.975))
    return JointConsistency(outputs, freedom, float(values.sum()) / freedom, (low, high))


def _states_consistency(run: Run, truth: Mapping[str, Array]) -> StateConsistency | None:
    names, P = tuple(truth), run.covariance
    for name, values in truth.items():
        if np.shape(values) != run[name].shape:
            raise BadShape(f"truth of {name} of shape {np.shape(values)}", f"must have shape {run[name].shape}")
    if P is None or not names:
        return None
    index = [run.names.index(name) for name in names]
    errors = np.column_stack([run.off(name, truth[name]) for name in names])
    P = P[:, index][:, :, index]
    sigma = np.sqrt(np.maximum(np.diagonal(P, axis1=1, axis2=2), 0.0))
    there = np.isfinite(errors).all(axis=1) & np.isfinite(P).all(axis=(1, 2)) & (sigma > 0).all(axis=1)
    if not there.any():
        return None
    scaled, scale = errors[there] / sigma[there], sigma[there, :, None] * sigma[there, None, :]
    inverse = np.linalg.pinv(P[there] / scale, hermitian=True)
    values, n = np.einsum("ki,kij,kj->k", scaled, inverse, scaled), len(names)
    tau = min(integrated_autocorrelation_time(values), float(len(values)))
    freedom = n * len(values) / tau
    low, high = (n * quantile(p, freedom) / freedom for p in (0.025, 0.975))
    return StateConsistency(names, len(values), tau, float(values.mean()), (low, high))


def prediction_warnings(predictions: Sequence[Prediction]) -> Iterator[str]:
    """Yield a sentence for each output that the model predicts worse than copying the last measured value does."""
    for output in dict.fromkeys(one.output for one in predictions):
        rows = [one for one in predictions if one.output == output and one.copying is not None]
        if rows and not any(one.copying for one in rows):
            yield (
                f"{output} is constant in the whole log, so that the error of copying is 0: give a log in which it "
                "moves"
            )
            continue
        worse = [one for one in rows if one.model > WORSE * (one.copying or 0.0)]
        if worse:
            steps = f"{', '.join(str(one.ahead) for one in worse)} step{'s' * (worse[-1].ahead != 1)} ahead"
            errors = ", ".join(f"{one.model:.3g} for {one.copying:.3g}" for one in worse)
            yield f"{output}: predictions are worse than copying {steps}, by RMS errors of {errors}; {_LATER}"


SPREADS = 6.5  # standard deviations of the innovation of noise between its mean and gamma_0
LEAST_SAMPLES = 100  # fewest samples for a standard deviation and a correlation


class TooLittle(BadArgument):
    """The error for a log that is too short, or has no noise, to estimate the noise."""


class BadWindow(BadArgument):
    """The error for a window shorter than the sampling period, or longer than the part of the log without
    excitation."""


@dataclass(frozen=True)
class Suggestion:
    """The sensor noise and the thresholds of an adaptive theta by a log without excitation: standard deviation sigma,
    correlation time tau, window d, thresholds gamma_0 and gamma_1, noise density R."""

    output: Annotated[str, "the output"]
    samples: Annotated[int, "number of samples"]
    sigma: Annotated[float, "standard deviation about a straight line, in the unit of y"]
    tau: Annotated[float, "correlation time (s); 0: white"]
    d: Annotated[float, "window of the innovation (s)"]
    spread: Annotated[float, "the quiet innovation's spread over its mean"]
    gamma_0: Annotated[float, "theta may rise above it (y^2 s)"]
    gamma_1: Annotated[float, "theta rises fully above it (y^2 s)"]
    R: Annotated[float, "spectral density of the noise (y^2 s)"]
    notes: Annotated[tuple[str, ...], "doubts"]


def suggest(output: str, y: np.ndarray, dt: float, d: float, unit: str = "s") -> Suggestion:
    """Return the sensor noise and the thresholds of an adaptive theta, estimated from y (N,), NaN where missing,
    sampled every `dt` without excitation; `d`: the window of the innovation; `unit`: the unit of `dt` and `d`. Raises:
    `TooLittle`, `BadWindow`."""
    there = np.isfinite(y)
    if there.sum() < LEAST_SAMPLES:
        least = f"give at least {LEAST_SAMPLES} from a quiet part of the record"
        raise TooLittle(output, f"has {there.sum()} samples; {least}")
    if not dt * (1 - 1e-9) <= d <= len(y) * dt * (1 + 1e-9):
        within = f"{dt:g}..{len(y) * dt:g} {unit}, from the sampling period to the length of the quiet part"
        raise BadWindow(f"the window d = {d:g} {unit}", f"must lie within {within}; give another by --window")
    t = np.arange(len(y)) * dt
    residual = y - np.polyval(np.polyfit(t[there], y[there], 1), t)
    sigma = float(np.std(residual[there], ddof=2))
    if sigma <= 1e-12 * float(np.abs(y[there]).max()):
        raise TooLittle(output, "is constant or a straight line: there is no noise to learn from")
    tau = correlation_time(residual, dt)
    window = max(1, round(d / dt))
    relative = spread(window, dt, tau)
    gamma = sigma**2 * d * (1 + SPREADS * relative)
    rho = math.exp(-dt / tau) if tau else 0.0
    notes = []
    kurtosis = float(np.mean(residual[there] ** 4)) / sigma**4
    if not 2 < kurtosis < 5:  # 3 for noise, 1.5 for a sine, more for steps and outliers
        notes.append(
            f"the values are not spread as noise is (kurtosis {kurtosis:.2g}, not about 3): is this part quiet?"
        )
    if tau > len(y) * dt / 30:
        notes.append(
            f"the correlation time is {tau:.3g} {unit} in a record of {len(y) * dt:.3g} {unit}: this part is not "
            "quiet, or too short; sigma contains the plant's own motion"
        )
    density = sigma**2 * dt * (1 + rho) / (1 - rho)
    return Suggestion(output, int(there.sum()), sigma, tau, d, relative, gamma, 2 * gamma, density, tuple(notes))


def correlation_time(residual: np.ndarray, dt: float) -> float:
    """Return the lag (s) at which the autocorrelation of a residual (N,), NaN where missing, falls to 1/e; 0 for white
    noise.

    Between samples the logarithm is interpolated, which is exact for an Ornstein-Uhlenbeck process. White: the first
    lag's correlation is within two standard deviations, 2/sqrt(N), of 0.
    """
    there = np.isfinite(residual).astype(float)
    value = np.where(there > 0, residual, 0.0)
    variance = float(np.sum(value**2) / np.sum(there))
    size, half = 2 * len(value), len(value) // 2  # padded to twice the length, against circular correlation
    sums, pairs = np.fft.irfft(np.abs(np.fft.rfft([value, there], size)) ** 2, size)[:, 1:half]
    last = 1.0
    for lag, now in enumerate((sums / np.maximum(np.rint(pairs), 1.0) / variance).tolist(), 1):
        if lag == 1 and now < 2 / math.sqrt(float(np.sum(there))):
            return 0.0
        if now <= math.exp(-1):
            if now <= 0:
                return lag * dt
            return float((lag - 1 + (1 + math.log(last)) / math.log(last / now)) * dt)
        last = now
    return half * dt


def spread(window: int, dt: float, tau: float) -> float:
    """Return standard deviation over mean of the innovation I_d of pure noise: the integral of |y - yhat|^2 over
    `window` samples, `dt` (s) apart, for noise with correlation time `tau` (s)."""
    if tau == 0:
        return math.sqrt(2 / window)
    k = np.arange(1, window)
    return math.sqrt(2 / window * (1 + 2 * float(np.sum((1 - k / window) * np.exp(-2 * dt / tau * k)))))
