"""Reports: functions of a step by which a caller reads how sure the estimate is, each only where `sample` names it.

    sigma   sqrt((T P T')_ii), T = dx/dz, P the covariance: the standard deviation of the estimate of each state x_i of
            the plant, as first declared; of a bank that of the selected member
    age     calls of predict since the last used sample of each output: 0 where this call used one, `OLDEST` for as
            many or more, and before the first
    innovation   e = y - h(z), S = C P C' + R of all outputs (p), at the prediction, before any sample is used

e is NaN where a sample is missing, and S of all outputs in any case; e' S^-1 e of the samples that are there is
chi-square with their number as degrees of freedom, if the model and the noise are right. A rejected sample counts.
From factors of P, T P T' is a sum of squares, without P; from P^-1 it is found by solving. An age counts the calls up
to the period of the sample's measurement, also of a late sample. A restart of the estimate changes no age; a reset
does.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import casadi as ca

from hgogen.estimators.riccati_part import lower, pack
from hgogen.observer import Observer
from hgogen.part import Clock, Pieces
from hgogen.program import Block, Field, Place, Program, Report, When, column, scalar, sym
from hgogen.reading.given import BadGain, among, names
from hgogen.signal import Signal
from hgogen.stepping.guards import LARGEST_NUMBER, sample

OLDEST = (1 << 16) - 1  # the largest number of the smallest `unsigned` of C
REPORTS = ("sigma", "age", "innovation")
E = Place("innovations", "e")
_COUNT = Place("state", "innovation_count")
_NO_SAMPLE = Block("of no sample", {_COUNT: ca.SX(0)})


def demand_reports(report: Any) -> tuple[str, ...]:
    """Return the names of reports in the order of `REPORTS`. Raises: `BadGain` for another name."""
    wanted = names("report", report)
    for name in wanted:
        if not among(name, REPORTS):
            raise BadGain(f"report {name!r}", f"is none; the reports are {', '.join(REPORTS)}")
    return tuple(name for name in REPORTS if name in wanted)


def reports(observer: Observer, clock: Clock, pieces: Pieces) -> tuple[Report, ...]:
    """Return the reports that a step has. Raises: `BadGain` for one that it cannot have."""
    makers = {
        "sigma": lambda: _sigma(observer, pieces),
        "age": lambda: _ages(observer),
        "innovation": lambda: _innovation(observer.form.system.outputs),
    }
    return tuple(makers[name]() for name in clock.report)


# --- sigma


def _sigma(observer: Observer, pieces: Pieces) -> Report:
    if pieces.projected is None:
        raise BadGain("report 'sigma'", f"needs a covariance, which {observer.name} has not; {_FILTERS}")
    states, u = [state for state, _ in observer.form.estimates], sym("state", "u", len(observer.form.system.inputs))
    rows = ca.vertsplit(observer.dynamics.estimate_jacobian(observer.z, u))
    programs, spreads = zip(*map(pieces.projected, rows), strict=True)
    places = (Place("deviations", state.name) for state in states)
    roots = {place: ca.sqrt(ca.fmax(spread, 0)) for place, spread in zip(places, spreads, strict=True)}  # of rounding
    if any(programs):  # each leaves what it computes in the same places
        blocks = (Block(f"standard deviation of {place.name}", {place: root}) for place, root in roots.items())
        program: Program = tuple(s for each, block in zip(programs, blocks, strict=True) for s in (*each, block))
    else:
        program = (Block("standard deviations of the plant's states", roots),)
    return Report(
        "sigma",
        "deviations",
        "standard deviations of the estimate of the plant's states, by the covariance of the observer",
        tuple(scalar(state.name, 0, unit=state.unit, meaning=f"of {state}") for state in states),
        pieces.inside(program),
        tuple(f"sigma_{state}" for state in states),
        (
            "They are the roots of the diagonal of T P T', P the covariance and T = dx/dz at the estimate.",
            "They are as good as Q and R: check them by a log with known states, or by the innovations.",
        ),
    )


_FILTERS = "take an observer with one, such as riccati, ukf or iterated_ekf, or leave the report out"


# --- age


def age_fields(outputs: Iterable[Signal]) -> tuple[Field, ...]:
    """Return the state's fields that count the calls of predict since the last used sample of each output."""
    meaning = f"calls of predict since the last used sample of {{}}, {OLDEST} for more"
    return tuple(scalar(_age(y), OLDEST, kind="index", high=OLDEST, meaning=meaning.format(y)) for y in outputs)


def increment_ages(outputs: Iterable[Signal]) -> Block:
    """Return the block of `predict` that increments the age of the last used sample of each output."""
    ages = {Place("state", _age(y)): sym("state", _age(y)) for y in outputs}
    older = {place: ca.if_else(age >= OLDEST, OLDEST, age + 1) for place, age in ages.items()}
    return Block("samples grow older", older)


def reset_age(output: Signal) -> Block:
    """Return the block of an update that sets the age of the output's last used sample to 0."""
    return Block(f"the newest sample of {output}", {Place("state", _age(output)): ca.SX(0)})


def reset_ages_where(outputs: Sequence[Signal], sampled: ca.SX) -> Program:
    """Return the statements of a `predict` that integrates samples: they set to 0 the ages of outputs with a sample, by
    the flags `sampled` (p)."""
    flags = [Place("work", f"sampled_{y}") for y in outputs]
    there = Block("which samples are there?", {flag: sampled[j] for j, flag in enumerate(flags)})
    return (there, *(When(flag, (reset_age(y),)) for flag, y in zip(flags, outputs, strict=True)))


def _age(output: Signal) -> str:
    return f"age_{output}"


def _ages(observer: Observer) -> Report:
    outputs = observer.form.system.outputs
    meaning = f"calls of predict since the last used sample of each output, 0 for one of this call, {OLDEST} for more"
    return Report(
        "age",
        "ages",
        meaning,
        tuple(scalar(y.name, 0, kind="index", meaning=f"of {y}") for y in outputs),
        (Block("ages", {Place("ages", y.name): sym("state", _age(y)) for y in outputs}),),
        tuple(map(_age, outputs)),
        (
            f"A restart of the estimate changes no age; `reset` makes all ages {OLDEST}.",
            "Of a late sample, the calls since the period of its measurement count.",
        ),
    )


# --- innovation


def innovation_fields(outputs: Sequence[Signal]) -> tuple[Field, ...]:
    """Return the state's fields with the joint innovations of this call."""
    return tuple(replace(field, name=_stored(field)) for field in _innovation_fields(outputs))


def no_innovation(outputs: int) -> Program:
    """Return the statements of `predict` that mark the joint innovations as missing; `outputs`: the number of
    outputs."""
    none = {Place("state", "innovation_e"): ca.SX.nan(outputs, 1)}
    return (Block("no innovation yet", none), _NO_SAMPLE)


def innovations(observer: Observer, clock: Clock, pieces: Pieces) -> Program:
    """Return the statements that compute the joint innovations. Raises: `BadGain` for an observer, or a step, that has
    none."""
    what = "report 'innovation'"
    if pieces.joint is None:
        raise BadGain(
            what, f"needs a prediction with a covariance, which {observer.name} by this method has not; {_AT}"
        )
    if clock.every or observer.delays:
        raise BadGain(what, "needs the samples of a call together; leave periods and delays out, or the report")
    outputs, dynamics = range(clock.outputs), observer.dynamics
    joint, predicted = pieces.joint(tuple(outputs)), dynamics.output(observer.z, clock.u_now)
    raw = [sample(observer, clock.u_now, j)[0] for j in outputs]
    there = [ca.fabs(y) <= LARGEST_NUMBER for y in raw]
    plain = (dynamics.output_error(j, raw[j], predicted[j]) for j in outputs)
    errors = [dynamics.output_error(j, error, joint.bias[j]) for j, error in enumerate(plain)]
    flags = [Place("work", f"sampled_{y.name}") for y in observer.form.system.outputs]
    values = {
        Place("state", "innovation_e"): column(map(ca.if_else, there, errors, [ca.SX.nan()] * len(there))),
        Place("state", "innovation_S"): pack(joint.covariance),
        **dict(zip(flags, there, strict=True)),
    }
    block = Block("the innovations at the prediction", values)
    one_more = Block("of one more", {_COUNT: sym(*_COUNT) + 1})
    return pieces.inside((*joint.program, block, _NO_SAMPLE, *(When(flag, (one_more,)) for flag in flags)))


_AT = "take riccati, ukf or iterated_ekf by continuous_discrete or cholesky, or leave the report out"


def _innovation_fields(outputs: Sequence[Signal]) -> tuple[Field, ...]:
    places, labels = lower(len(outputs)), tuple(map(str, outputs))
    zeros, entries = (0.0,) * len(places), tuple((i + 1, j + 1) for i, j in places)
    return (
        Field(E.name, zeros[: len(outputs)], labels=labels, meaning="y - h, NaN for a missing sample"),
        Field("S", zeros, entries=entries, meaning="covariance of e, lower triangle by columns"),
        scalar("count", 0, kind="index", high=len(outputs), meaning="samples that are there"),
    )


def _stored(field: Field) -> str:
    return f"innovation_{field.name}"


def _innovation(outputs: Sequence[Signal]) -> Report:
    fields = _innovation_fields(outputs)
    copies = {Place(E.struct, field.name): sym("state", _stored(field), field.size) for field in fields}
    names = (*map(str, outputs), *(f"S_{outputs[i]}_{outputs[j]}" for i, j in lower(len(outputs))), "count")
    return Report(
        "innovation",
        E.struct,
        "joint innovations of all outputs at the prediction, before any sample is used, and their covariance",
        fields,
        (Block("the innovations of this call", copies),),
        tuple(f"innovation_{name}" for name in names),
        (
            "S is C P C' + R. A rejected sample has its innovation too, and `count` is the number of samples.",
            "e' S^-1 e, without the rows and columns of missing samples, is chi-square with `count` degrees of freedom "
            "where the model, Q and R are right.",
        ),
    )
