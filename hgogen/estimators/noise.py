"""Noise as it is declared: spectral densities, or variances and standard deviations of one sample.

An observer works with the densities Q (z^2/s) and R (y^2 s). A step of the period dt uses

    P <- Phi P Phi' + Q_d,  Q_d = Q dt once in a step,     r_j = R_j/T_j for a sample of output j,

T_j the time between two samples of that output, by default dt. Other tools, and data sheets, give Q_d and r_j. What is
given for one sample becomes a density when a step is made, at its dt and T_j: Q = Q_d/dt, R_j = r_j T_j. Where that
step is rebuilt with another dt, r_j stays, and Q_d grows with dt.

A sample of an input that errs by a standard deviation sigma, independently of the others, and acts for a step moves the
state by dt f_u sigma, to first order in dt: the density of the process noise grows by f_u U f_u' with U = sigma^2 dt.
Between samples on a line, a sample acts on two steps, by dt in all. sigma stays where dt changes.

For a discrete plant Q, R and U are already the noise of one sample, and its steps have the period 1.
"""

from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial, wraps
from inspect import Parameter, signature
from math import sqrt
from typing import TYPE_CHECKING, Any

import numpy as np
import sympy as sp

from hgogen.analysis.dynamics import HUGE, transformed
from hgogen.check import Check, ClaimId, Verdict
from hgogen.estimators.riccati_part import (
    Riccati,
    RiccatiVariant,
    Variances,
    is_diagonal,
    output_noise,
    positive_numbers,
    semidefinite,
    spd,
)
from hgogen.form import Form
from hgogen.observer import Observer, cached_observers
from hgogen.reading.expression import parse
from hgogen.reading.given import (
    FACTORED,
    BadGain,
    by_coordinate,
    by_output,
    demand_switch,
    has_expressions,
    in_order,
    names_of,
    positive,
)
from hgogen.rigor.bounds import nonzero, place
from hgogen.sentence import because, joined

if TYPE_CHECKING:
    from hgogen.step import Step

SPELLINGS = {  # the keywords besides Q and R, with the type that a signature shows
    "noise": "Mapping[str, float] | None",
    "R_per_sample": "float | Values | None",
    "Q_per_sample": "Matrix | None",
    "density": bool,
}
_DENSITIES = ("Q", "R", "U")
_OF_RANKS = (ClaimId("riccati", "convergence"),)
_EVERY = because("for every dt, since Q grows in proportion")
_OPEN = because("its numbers follow from the noise of a sample and dt: ask the observer of a step")


@dataclass(frozen=True)
class Noise:
    """The noise of an observer as declared: as densities `Q`, `R` and `U`, which the observer accepts; or for one
    sample: the covariance `process` (n, n) that a step adds, the covariance `samples` (p, p) of the outputs, the
    variances of `inputs` by name. None for each that is not declared. `inverse`: whether the observer accepts weights,
    Q^-1 and R^-1; `varying`: variances of outputs that are expressions."""

    Q: Any = None
    R: Any = None
    U: Any = None
    process: np.ndarray | None = None
    samples: np.ndarray | None = None
    inputs: Mapping[str, float] | None = None
    inverse: bool = False
    varying: Variances | None = None

    @property
    def sampled(self) -> bool:
        """Whether noise is declared for one sample, so that its density depends on dt."""
        return any(each is not None for each in (self.process, self.samples, self.inputs))

    def densities(self, periods: Sequence[float], process_dt: float) -> dict[str, Any]:
        """Return the observer's arguments Q, R and U that are declared, as densities: `periods` = (dt, *T) of a step
        and of the outputs' samples (p); the declared process noise is added every `process_dt`."""
        Q, R, U = self.Q, self.R, self.U
        if self.process is not None:
            density = self.process / process_dt
            Q = np.linalg.inv(density) if self.inverse else density
        if self.samples is not None:
            roots = np.sqrt(periods[1:])
            each = (np.diag(self.samples) * periods[1:]).tolist()
            R = [1 / r for r in each] if self.inverse else each
            if not is_diagonal(self.samples):
                R = self.samples * np.outer(roots, roots)
        if self.inputs is not None:
            U = {name: variance * periods[0] for name, variance in self.inputs.items()}
        if self.varying is not None:
            R = replace(self.varying, densities=tuple(R))
        return {name: value for name, value in (("Q", Q), ("R", R), ("U", U)) if value is not None}


def declares_noise(make: Callable[..., Observer]) -> Callable[..., Observer]:
    """Return the observer function `make` with further keywords for the noise of one sample (`SPELLINGS`), in place of
    Q, R and U; Q_per_sample only if it has an argument Q. If the noise is declared for one sample, the densities are
    computed when a step is made."""
    return _declares(make, inverse=False)


def declares_weights(make: Callable[..., Observer]) -> Callable[..., Observer]:
    """Return the observer function `make` with further keywords as `declares_noise` adds them, where its arguments Q
    and R are weights, the inverses of the noise."""
    return _declares(make, inverse=True)


def _declares(make: Callable[..., Observer], inverse: bool) -> Callable[..., Observer]:
    own = signature(make).parameters
    spelled = [name for name in SPELLINGS if name != "Q_per_sample" or "Q" in own]
    plain = cached_observers(make)

    @wraps(make)
    def declared(form: Form, **arguments: Any) -> Observer:
        others = {name: value for name, value in arguments.items() if name not in (*_DENSITIES, *spelled)}
        if not isinstance(form, Form):
            return make(form, Q=None, R=None, **others) if "Q" in own else make(form, R=None, **others)
        known = _read(make.__name__, form, arguments, own, inverse)
        if not known.sampled:
            return make(form, **known.densities((), 1.0), **others)

        def at(periods: Sequence[float], process_dt: float) -> Observer:
            return plain(form, **known.densities(periods, process_dt), **others)

        observer = at((1.0,) * (1 + len(form.output)), 1.0)
        return replace(observer, at_period=at, claims=partial(_open_claims, observer, form))

    keywords = [
        Parameter(name, Parameter.KEYWORD_ONLY, default=False if kind is bool else None, annotation=kind)
        for name, kind in SPELLINGS.items()
        if name in spelled
    ]
    first, *remaining = (
        each.replace(default=None) if each.name in _DENSITIES and each.default is Parameter.empty else each
        for each in own.values()
    )
    place = 1 + max(k for k, each in enumerate(remaining) if each.name in _DENSITIES)
    vars(declared)["__signature__"] = signature(make).replace(
        parameters=[first, *remaining[:place], *keywords, *remaining[place:]]
    )
    return declared


def _open_claims(observer: Observer, form: Form) -> tuple[Check, ...]:
    """Return the checks of an observer whose densities are unknown before dt is: a proved claim of its own becomes
    unknown, unless it depends only on the rank of Q, and so holds for every dt."""
    of_form = {check.id for check in form.checks}
    own = [check for check in observer.checks if check.verdict is Verdict.PROVED and check.id not in of_form]
    unknown = {c.id: replace(c, verdict=Verdict.UNKNOWN, reason=_OPEN, proofs=()) for c in own}
    unknown |= {c.id: replace(c, reason=joined(c.reason, _EVERY), proofs=()) for c in own if c.id in _OF_RANKS}
    return tuple(unknown.get(check.id, check) for check in observer.checks)


def _read(observer: str, form: Form, arguments: Mapping[str, Any], own: Container[str], inverse: bool) -> Noise:
    """Return the noise that the `arguments` declare; `own`: the names of the observer's own arguments, such as Q.
    Raises: `BadGain`, `BadNames`."""
    known = {name: value for name, value in arguments.items() if value is not None}
    _demand_density(observer, form, known)
    noise = _deviations(observer, form, known["noise"], own) if "noise" in known else {}
    inputs = {name: noise.pop(name) ** 2 for name in names_of(form.system.supplied) if name in noise}
    if not noise:
        known.pop("noise", None)
    _demand_measured(observer, known, inputs, own)
    varying = None
    for name in ("R", "R_per_sample"):
        if has_expressions(known.get(name)):
            varying = _expressions(observer, name, known.pop(name), form, own)
            known["R_per_sample"] = varying.densities
    if inputs and "U" in known:
        _demand_one(observer, {"U": inputs, "noise": inputs}, "noise of inputs", ("U", "noise"))
    if (inputs or "U" in known) and not known.keys() & {"Q", "Q_per_sample"}:
        known["Q"] = np.zeros(form.n)
    if "Q" in own:
        _demand_one(observer, known, "process noise", ("Q", "Q_per_sample"))
    if form.system.discrete:
        known |= {f"{name}_per_sample": known.pop(name) for name in ("Q", "R") if name in known}
    Q, read = known.get("Q_per_sample"), spd if inverse else semidefinite
    process = None if Q is None else read("Q_per_sample", by_coordinate("Q_per_sample", Q, form), form.n)
    samples = _of_a_sample(observer, form, noise, known.get("R_per_sample"), own)
    return Noise(known.get("Q"), known.get("R"), known.get("U"), process, samples, inputs or None, inverse, varying)


def _demand_density(observer: str, form: Form, known: Mapping[str, Any]) -> None:
    demand_switch("density", known.get("density", False))
    if form.system.discrete and known.get("density"):
        raise BadGain("density = True", "is for differential equations: Q and R of a discrete plant are of one sample")
    if known.get("density") and not known.keys() & {*_DENSITIES}:
        raise BadGain("density = True", f"says that Q and R are densities, and {observer} has neither")


def _demand_measured(observer: str, known: Mapping[str, Any], inputs: Mapping[str, float], own: Container[str]) -> None:
    if "Q" in own and not (inputs or known.keys() & {"R", "R_per_sample", "noise", "Q", "Q_per_sample", "U"}):
        raise BadGain(observer, "has neither process nor measurement noise; give Q, and noise or R")
    _demand_one(observer, known, "measurement noise", ("R", "R_per_sample", "noise"))


def _of_a_sample(
    observer: str, form: Form, noise: Mapping[str, float], R: Any, own: Container[str]
) -> np.ndarray | None:
    """Return the covariance (p, p) of one sample of the outputs, from the standard deviations `noise` by output, or
    from R; None if neither is declared."""
    if noise:
        squares = [sigma * sigma for sigma in in_order("noise", noise, names_of(form.system.outputs))]
        return np.diag(positive_numbers("the squares of noise", squares, len(form.output)))
    if R is None:
        return None
    samples = output_noise("R_per_sample", R, form)
    if "update" not in own and not is_diagonal(samples):
        raise BadGain("R_per_sample", f"is a matrix, and {observer} takes a number for each output")
    return samples


def _expressions(observer: str, name: str, value: Any, form: Form, own: Container[str]) -> Variances:
    """Return the variances of one sample from expressions, or numbers, by the outputs' names. Raises: `BadGain`,
    `BadNames`, `BadExpression`."""
    if "update" not in own:
        raise BadGain(name, f"has an expression, and {observer} takes numbers; take riccati, ukf or iterated_ekf")
    written = by_output(name, value, form)
    if name == "R" and not form.system.discrete and not all(isinstance(each, str | sp.Basic) for each in written):
        raise BadGain("R", "has numbers, which are densities, with variances of a sample; give all in R_per_sample")
    if transformed(form):
        raise BadGain(name, f"has an expression, which the form {form.kind} does not take; take hg.forms.original")
    each = zip(names_of(form.system.outputs), written, strict=True)
    known = [_variance(f"{name} of {y}", entry, form) for y, entry in each]
    densities = tuple(float(e) if e.is_number else 1.0 for e, _ in known)
    return Variances(densities, tuple(sp.S.One if e.is_number else e for e, _ in known), tuple(low for _, low in known))


def _variance(what: str, written: Any, form: Form) -> tuple[sp.Expr, float]:
    """Return an expression of states, inputs and parameters that is proved to be positive, and its lower bound."""
    system = form.system
    symbols = {s.name: s for s in (*system.states, *system.inputs, *system.parameters)}
    if isinstance(written, str):
        expression = parse(written, symbols, {cells.name: cells for cells in system.tables})
    else:
        expression = sp.sympify(written)
    for symbol in sorted(expression.free_symbols - {*symbols.values()}, key=str):
        raise BadGain(what, f"reads {symbol}, which is no state, input or parameter; write it in these")
    if expression.is_number:
        return expression, float(expression)
    known = nonzero(expression, system.box)
    if not (known.sign > 0 and known.margin >= HUGE**-2):
        why = f"{known.reason}{place(known.witness)}" if known.sign == 0 else str(known)
        reason = f"= {expression} is not proved to be positive on the declared ranges ({why})"
        raise BadGain(what, f"{reason}; add a positive number, or narrow the ranges")
    return expression, float(known.margin)


def _demand_one(observer: str, known: Mapping[str, Any], what: str, names: Sequence[str]) -> None:
    """Raise `BadGain` unless exactly one of the arguments `names` is given; `what`: the quantity that they declare."""
    present = [name for name in names if name in known]
    if len(present) != 1:
        listed = f"{', '.join(names[:-1])} or {names[-1]}"
        reason = f"was given its {what} twice, as {' and '.join(present)}" if present else f"has no {what}"
        raise BadGain(observer, f"{reason}; give one of {listed}")


def _deviations(observer: str, form: Form, noise: Any, own: Container[str]) -> dict[str, float]:
    """Return the standard deviations of one sample, from a mapping by the names of outputs, and of inputs where the
    observer has `U` among its `own` arguments. Raises: `BadGain`, `BadNames`."""
    outputs, inputs = names_of(form.system.outputs), names_of(form.system.supplied)
    if not isinstance(noise, Mapping):
        raise BadGain(
            f"noise = {noise!r:.60}", f"must be standard deviations of one sample by name, as {{{outputs[0]!r}: 0.01}}"
        )
    reason = f"an input: {observer} has no noise of inputs; leave it out, or take riccati, ukf or iterated_ekf"
    names, elsewhere = (*outputs, *inputs), dict[str, str]()
    if "U" not in own:
        names, elsewhere = outputs, dict.fromkeys(inputs, reason)
    each = in_order("noise", noise, names, default=dict.fromkeys(names), elsewhere=elsewhere)
    return {
        name: positive(f"noise of {name}", sigma) for name, sigma in zip(names, each, strict=True) if sigma is not None
    }


# --- reports

_DEVIATIONS: Mapping[str, Callable[[float, float], float]] = {  # sigma of a sample for T, by the gain's unit
    "y^2 s": lambda R, T: sqrt(R / T),
    "y^2": lambda R, T: sqrt(R / T),
    FACTORED: lambda R, T: sqrt(R / T),
    "1/(y^2 s)": lambda R, T: sqrt(1 / (R * T)),
    "u^2 s": lambda U, dt: sqrt(U / dt),
    "u^2": lambda U, dt: sqrt(U / dt),
}


def sample_deviations(step: "Step") -> dict[str, float]:
    """Return the standard deviation of one sample of each output, and of each input with noise, in the signal's unit,
    from the gains R and U of a step at theta = 1. Empty for an observer without R; an output whose variance is an
    expression is left out."""
    periods = dict(zip(names_of(step.outputs), step.clock.periods, strict=True))
    factors = [part.correlated for part in _riccati_parts(step) if part.correlated is not None]
    deviations = {}
    for field in step.layout.gains:
        if field.unit in _DEVIATIONS and field.labels:  # the thresholds of an innovation have none
            d = np.array(field.initial)
            densities = (factors[0] ** 2) @ d if field.unit == FACTORED else d  # of D the diagonal of R = L D L'
            for name, density in zip(field.labels, densities.tolist(), strict=True):
                deviations[name] = _DEVIATIONS[field.unit](density, periods.get(name, step.clock.longest))
    return {name: deviation for name, deviation in deviations.items() if name not in _varying(step)}


def _riccati_parts(step: "Step") -> list[Riccati]:
    parts = (part.plain if isinstance(part, RiccatiVariant) else part for part in step.observer.parts)
    return [part for part in parts if isinstance(part, Riccati)]


def _varying(step: "Step") -> dict[str, sp.Expr]:
    """Return those variances of one sample that are expressions, by the outputs' names."""
    known = [part.varying for part in _riccati_parts(step) if part.varying is not None]
    each = (zip(names_of(step.outputs), one.expressions, strict=True) for one in known)
    return {name: e for pairs in each for name, e in pairs if not e.is_number}


def deviation_lines(step: "Step") -> tuple[str, ...]:
    """Return texts that give R and U as standard deviations of one sample; none for an observer without R."""
    deviations, lines = sample_deviations(step), []
    for gain, signals in (("R", step.outputs), ("U", step.inputs)):
        known = [s for s in signals if s.name in deviations]
        each = [f"{s.name} = {deviations[s.name]:.4g}{f' {s.unit}' if s.unit else ''}" for s in known]
        if each:
            lines.append(f"{gain} as the standard deviation of one sample: {', '.join(each)}")
    varying = [f"{name} = {e}" for name, e in _varying(step).items()]
    return (*lines, *[f"variance of one sample: {', '.join(varying)}"][: len(varying)])
