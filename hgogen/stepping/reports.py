"""Reports: functions of a step by which a caller reads how sure the estimate is, each only where `sample` names it.

    sigma   sqrt((T P T')_ii), T = dx/dz, P the covariance: the standard deviation of the estimate of each state x_i of
            the plant, as first declared; of a bank that of the selected member
    age     calls of predict since the last used sample of each output: 0 where this call used one, `OLDEST` for as
            many or more, and before the first

From factors of P, T P T' is a sum of squares, without P; from P^-1 it is found by solving. An age counts the calls up
to the period of the sample's measurement, also of a late sample. A restart of the estimate changes no age; a reset
does.
"""

from collections.abc import Iterable, Sequence
from typing import Any

import casadi as ca

from hgogen.observer import Observer
from hgogen.part import Pieces
from hgogen.program import Block, Field, Place, Program, Report, When, scalar, sym
from hgogen.reading.given import BadGain, names
from hgogen.signal import Signal

OLDEST = (1 << 16) - 1  # the largest number of the smallest `unsigned` of C
REPORTS = ("sigma", "age")


def demand_reports(report: Any) -> tuple[str, ...]:
    """Return the names of reports in the order of `REPORTS`. Raises: `BadGain` for another name."""
    wanted = names("report", report)
    for name in wanted:
        if name not in REPORTS:
            raise BadGain(f"report {name!r}", f"is none; the reports are {', '.join(REPORTS)}")
    return tuple(name for name in REPORTS if name in wanted)


def reports(observer: Observer, pieces: Pieces, wanted: Iterable[str]) -> tuple[Report, ...]:
    """Return the reports of these names. Raises: `BadGain` for one that needs a covariance, without one."""
    makers = {"sigma": lambda: _sigma(observer, pieces), "age": lambda: _ages(observer)}
    return tuple(makers[name]() for name in wanted)


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


def aged(outputs: Iterable[Signal]) -> Block:
    """Return the block of a predict that makes every sample older."""
    ages = {Place("state", _age(y)): sym("state", _age(y)) for y in outputs}
    older = {place: ca.if_else(age >= OLDEST, OLDEST, age + 1) for place, age in ages.items()}
    return Block("samples grow older", older)


def renewed(output: Signal) -> Block:
    """Return the block of an update that has used a sample of the output."""
    return Block(f"the newest sample of {output}", {Place("state", _age(output)): ca.SX(0)})


def renewed_where(outputs: Sequence[Signal], sampled: ca.SX) -> Program:
    """Return the statements of a predict that uses samples of the outputs: those that are there, by `sampled` (p)."""
    flags = [Place("work", f"sampled_{y}") for y in outputs]
    there = Block("which samples are there?", {flag: sampled[j] for j, flag in enumerate(flags)})
    return (there, *(When(flag, (renewed(y),)) for flag, y in zip(flags, outputs, strict=True)))


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
