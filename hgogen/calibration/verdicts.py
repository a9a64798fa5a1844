"""What tuning comes to, a sentence each: the row to take and why, where measures disagree, and what does as well."""

import math
from collections.abc import Iterator, Mapping, Sequence

from hgogen.calibration.judged import COPYING, DIFFERENCING, Judged
from hgogen.calibration.tuned import Calibration, Tuned
from hgogen.identification.whiteness import LAGS

AS_WELL = 1.05  # times an error: as well
HELD_OUT, ALL = "in the rows held out", "in all rows"
COLOURED = 5  # of the first correlations: more in one white record of 5,000
CONSISTENT = 2.0  # times larger or smaller than 1: a NIS of a filter whose variances are right


def verdicts(calibration: Calibration, rows: Sequence[Judged], where: str = HELD_OUT) -> tuple[str, ...]:
    """Of a calibration and of rows that are judged, by default those held out."""
    judged = {row.name: row for row in rows}
    best = judged[calibration.best.name]
    return (
        *_taken(calibration),
        *_other_horizons(best, judged, where),
        *_without_a_model(best, judged, where),
        *_hidden(best, judged, calibration.truth),
        *_doubts(calibration.best, best, where),
    )


def _taken(calibration: Calibration) -> Iterator[str]:
    """The row to take, by what gains were chosen, and whether it is worth more than what does without a model."""
    best, first, states = calibration.best, calibration.rows[0], calibration.truth
    measure, rival = _ahead(calibration.ahead), "copying the last value"
    if states:
        measure = f"by the truth of {', '.join(states)}"
        rival = "its mean value" if len(states) == 1 else "their mean values"
    said = (
        f"take {best.name}: {measure}, on segments that did not choose its gains, it errs {best.error:.3g} times as "
        f"much as {rival}"
    )
    if best is first:
        others = ", ".join(row.name for row in calibration.tied if row is not best)
        yield f"{said}, the least of all" + (f"; as well, within the standard error: {others}" if others else "")
    else:
        cheaper = "knows its noise" if first.noise is None else "costs less"
        why = "has a proof" if best.rank[0] < first.rank[0] else cheaper
        yield f"{said}; {first.name} errs {first.error:.3g}, within the standard error, but {best.name} {why}"
    if best.error >= 1:
        yield (
            f"no gains of {best.name} do better than {rival}: the model does not predict "
            "these records; fit its parameters, check ranges, units and period, or give a longer record"
        )


def _ahead(samples: int) -> str:
    return f"{samples} sample{'s' * (samples > 1)} ahead"


def _other_horizons(best: Judged, judged: Mapping[str, Judged], where: str) -> Iterator[str]:
    """Where another row errs clearly less."""
    for ahead, errors in best.errors.items():
        for output, error in errors.items():
            others = {name: row.errors[ahead][output] for name, row in judged.items() if name not in _MODELLESS}
            name = min(others, key=lambda each: others[each] if others[each] == others[each] else math.inf)
            if others[name] * AS_WELL < error:
                better = f"{name} predicts {output} better {_ahead(ahead)}, {others[name]:.3g} for {error:.3g}"
                yield f"{where}, {better}"


def _without_a_model(best: Judged, judged: Mapping[str, Judged], where: str) -> Iterator[str]:
    """Where no model does as well."""
    for name in _MODELLESS:
        for output in next(iter(best.errors.values()), {}):
            pairs = [(h, errors[output], judged[name].errors[h][output]) for h, errors in best.errors.items()]
            as_well = [str(h) for h, own, other in pairs if other <= AS_WELL * own]
            if as_well:
                samples = f"{', '.join(as_well)} sample{'s' * (as_well != ['1'])} ahead"
                yield f"{where}, {name} predicts {output} as well as {best.name}, {samples}"


def _hidden(best: Judged, judged: Mapping[str, Judged], seen: Sequence[str]) -> Iterator[str]:
    """What the truth says of the choice, which did not see it but for the states `seen`."""
    for state, error in best.hidden.items():
        others = {name: row.hidden[state] for name, row in judged.items() if state in row.hidden and row is not best}
        differenced = others.pop(DIFFERENCING, None)
        if differenced is not None and differenced <= AS_WELL * error:
            yield f"differencing estimates {state} as well, {differenced:.3g} for {error:.3g}"
        name = min(others, key=lambda each: others[each], default=None)
        if name is not None and others[name] * AS_WELL < error:
            better = f"{name} is better, {others[name]:.3g} for {error:.3g}"
            yield f"by the truth of {state}{'' if state in seen else ', which is not tuned on'}, {better}"


def _doubts(best: Tuned, judged: Judged, where: str) -> Iterator[str]:
    for output, nis in judged.nis.items():
        if not 1 / CONSISTENT <= nis <= CONSISTENT:
            more = "more" if nis > 1 else "less"
            yield (
                f"innovations of {output} are {math.sqrt(nis):.2g} times as large as {best.name} takes them to be, "
                f"{where}: they scatter {more} there, and its variances are not to be trusted"
            )
    for output, count in judged.coloured.items():
        if count > COLOURED:
            yield (
                f"innovations of {output} are not white, {count} of the first {LAGS} correlations, {where}: the plant "
                "does more than the model, a sensor or an input is late, or the noise is slow; see longer horizons too"
            )
    thetas = sorted({numbers.theta for numbers, _ in best.tried})
    if len(thetas) > 1 and best.numbers.theta in (thetas[0], thetas[-1]):
        end = "least" if best.numbers.theta == thetas[0] else "largest that a step of this period takes"
        yield f"its theta {best.numbers.theta:g} is the {end}"
    if best.noise is not None and not best.noise.settled:
        yield "the search for Q and R did not settle; give a longer record, or one that moves more"


_MODELLESS = (COPYING, DIFFERENCING)
