"""Noise as it is declared: spectral densities, or variances and standard deviations of one sample.

An observer works with the densities Q (z^2/s) and R (y^2 s). A step of the period dt uses

    P <- Phi P Phi' + Q_d,  Q_d = Q dt once in a step,     r_j = R_j/T_j for a sample of output j,

T_j the time between two samples of that output, by default dt. Other tools, and data sheets, give Q_d and r_j. What is
given for one sample becomes a density when a step is made, at its dt and T_j: Q = Q_d/dt, R_j = r_j T_j. Where that
step is rebuilt with another dt, r_j stays, and Q_d grows with dt.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial, wraps
from inspect import Parameter, signature
from math import sqrt
from typing import TYPE_CHECKING, Any

import numpy as np

from hgogen.check import Check, Verdict
from hgogen.estimators.riccati_part import positive_numbers, semidefinite, spd
from hgogen.form import Form
from hgogen.observer import Observer, remembered
from hgogen.reading.given import BadGain, by_coordinate, by_output, demand_switch, in_order, names_of, positive
from hgogen.sentence import because

if TYPE_CHECKING:
    from hgogen.step import Step

SPELLINGS = {  # the keywords besides Q and R, with the type that a signature shows
    "noise": "Mapping[str, float] | None",
    "R_per_sample": "float | Values | None",
    "Q_per_sample": "Matrix | None",
    "density": bool,
}
_OPEN = because("its numbers follow from the noise of a sample and dt: ask the observer of a step")


@dataclass(frozen=True)
class Noise:
    """The noise of an observer as declared: either densities `Q` and `R`, as the observer accepts them, or the
    covariance `process` (n, n) that a step adds and the variances `samples` (p) of one sample of each output; None for
    what is given in the other way, or not at all. `inverse`: the observer accepts weights, Q^-1 and R^-1."""

    Q: Any = None
    R: Any = None
    process: np.ndarray | None = None
    samples: tuple[float, ...] | None = None
    inverse: bool = False

    @property
    def sampled(self) -> bool:
        """Whether a number is that of a sample, so that its density depends on dt."""
        return self.process is not None or self.samples is not None

    def densities(self, periods: Sequence[float], process_dt: float) -> dict[str, Any]:
        """Return the arguments Q and R of the observer for outputs' samples that are `periods` (p) apart, `process`
        being added every `process_dt`; without Q where none is declared."""
        Q, R = self.Q, self.R
        if self.process is not None:
            density = self.process / process_dt
            Q = np.linalg.inv(density) if self.inverse else density
        if self.samples is not None:
            each = [variance * period for variance, period in zip(self.samples, periods, strict=True)]
            R = [1 / r for r in each] if self.inverse else each
        return {name: value for name, value in (("Q", Q), ("R", R)) if value is not None}


def declares_noise(make: Callable[..., Observer]) -> Callable[..., Observer]:
    """Return an observer's function with the keywords of `SPELLINGS` besides its Q and R; Q_per_sample where it has a
    Q. An observer whose noise is that of a sample gets its densities when a step is made."""
    return _declares(make, inverse=False)


def declares_weights(make: Callable[..., Observer]) -> Callable[..., Observer]:
    """Return an observer's function as `declares_noise` does, of an observer whose Q and R are weights, inverses of the
    noise."""
    return _declares(make, inverse=True)


def _declares(make: Callable[..., Observer], inverse: bool) -> Callable[..., Observer]:
    own = signature(make).parameters
    spelled = [name for name in SPELLINGS if name != "Q_per_sample" or "Q" in own]
    plain = remembered(make)

    @wraps(make)
    def declared(form: Form, **arguments: Any) -> Observer:
        others = {name: value for name, value in arguments.items() if name not in ("Q", "R", *spelled)}
        if not isinstance(form, Form):
            return make(form, Q=None, R=None, **others) if "Q" in own else make(form, R=None, **others)
        known = _read(make.__name__, form, arguments, needs_process="Q" in own, inverse=inverse)
        if not known.sampled:
            return make(form, **known.densities((), 1.0), **others)

        def at(periods: Sequence[float], process_dt: float) -> Observer:
            return plain(form, **known.densities(periods, process_dt), **others)

        observer = at((1.0,) * len(form.output), 1.0)
        return replace(observer, at_period=at, claims=partial(_open_claims, observer, form))

    keywords = [
        Parameter(name, Parameter.KEYWORD_ONLY, default=False if kind is bool else None, annotation=kind)
        for name, kind in SPELLINGS.items()
        if name in spelled
    ]
    first, *remaining = (
        each.replace(default=None) if each.name in ("Q", "R") and each.default is Parameter.empty else each
        for each in own.values()
    )
    place = 1 + max(k for k, each in enumerate(remaining) if each.name in ("Q", "R"))
    vars(declared)["__signature__"] = signature(make).replace(
        parameters=[first, *remaining[:place], *keywords, *remaining[place:]]
    )
    return declared


def _open_claims(observer: Observer, form: Form) -> tuple[Check, ...]:
    """Return the checks of an observer whose densities are not known yet: those of the form, and its own as unknown."""
    return tuple(
        check
        if check.id in {each.id for each in form.checks} or check.verdict is not Verdict.PROVED
        else replace(check, verdict=Verdict.UNKNOWN, reason=_OPEN, proofs=())
        for check in observer.checks
    )


def _read(observer: str, form: Form, arguments: Mapping[str, Any], needs_process: bool, inverse: bool) -> Noise:
    """Return the noise that the `arguments` declare. Raises: `BadGain`, `BadNames`."""
    known = {name: value for name, value in arguments.items() if value is not None}
    demand_switch("density", arguments.get("density", False))
    densities = [name for name in ("Q", "R") if name in known]
    if arguments.get("density") and not densities:
        raise BadGain("density = True", f"says that Q and R are densities, and {observer} was given neither")
    _demand_one(observer, known, "measurement noise", ("R", "R_per_sample", "noise"))
    if needs_process:
        _demand_one(observer, known, "process noise", ("Q", "Q_per_sample"))
    process, samples, outputs = None, None, len(form.output)
    if "Q_per_sample" in known:
        read = spd if inverse else semidefinite
        process = read("Q_per_sample", by_coordinate("Q_per_sample", known["Q_per_sample"], form), form.n)
    if "R_per_sample" in known:
        samples = positive_numbers("R_per_sample", by_output("R_per_sample", known["R_per_sample"], form), outputs)
    if "noise" in known:
        samples = tuple(sigma * sigma for sigma in _deviations(form, known["noise"]))
        positive_numbers("the squares of noise", list(samples), outputs)
    return Noise(known.get("Q"), known.get("R"), process, samples, inverse)


def _demand_one(observer: str, known: Mapping[str, Any], what: str, names: Sequence[str]) -> None:
    """Raise `BadGain` unless exactly one of the arguments `names` is given."""
    present = [name for name in names if name in known]
    if len(present) != 1:
        listed = f"{', '.join(names[:-1])} or {names[-1]}"
        reason = f"was given its {what} twice, as {' and '.join(present)}" if present else f"has no {what}"
        raise BadGain(observer, f"{reason}; give one of {listed}")


def _deviations(form: Form, noise: Any) -> list[float]:
    """Return the standard deviations (p) of one sample, from a mapping by the outputs' names. Raises: `BadGain`,
    `BadNames`."""
    names = names_of(form.system.outputs)
    if not isinstance(noise, Mapping):
        raise BadGain(
            f"noise = {noise!r:.60}", f"must be standard deviations of one sample by name, as {{{names[0]!r}: 0.01}}"
        )
    return [
        positive(f"noise of {name}", sigma) for name, sigma in zip(names, in_order("noise", noise, names), strict=True)
    ]


# --- reports

_DEVIATIONS: Mapping[str, Callable[[float, float], float]] = {  # sigma from R and T, by R's unit
    "y^2 s": lambda R, T: sqrt(R / T),
    "1/(y^2 s)": lambda R, T: sqrt(1 / (R * T)),
}


def sample_deviations(step: "Step") -> dict[str, float]:
    """Return the standard deviation of one sample of each output, from the gain R of a step at theta = 1, in the
    output's unit; empty for an observer without R."""
    fields = (field for field in step.layout.gains if field.name == "R" and field.unit in _DEVIATIONS)
    return {
        name: _DEVIATIONS[field.unit](R, T)
        for field in fields
        for name, R, T in zip(field.labels, field.initial, step.clock.periods, strict=True)
    }


def deviation_lines(step: "Step") -> tuple[str, ...]:
    """Return a line with `sample_deviations`, none for an observer without R."""
    units = {y.name: f" {y.unit}" if y.unit else "" for y in step.outputs}
    each = [f"{name} = {sigma:.4g}{units[name]}" for name, sigma in sample_deviations(step).items()]
    return (f"R as the standard deviation of one sample: {', '.join(each)}",) if each else ()
