"""Tables of what measured records tell: fits, tunings, predictions, noise."""

import math
from collections.abc import Iterable, Mapping, Sequence

from rich.console import Group, RenderableType
from rich.text import Text

from hgogen.commands.output import filled, headed
from hgogen.logs.result import Fit
from hgogen.reading.measured import Report
from hgogen.run.comparison import Difference
from hgogen.run.consistency import Consistency
from hgogen.run.prediction import Prediction
from hgogen.signal import Signal


def predictions(each: Sequence[Prediction], dt: float, unit: str) -> RenderableType:
    """RMS prediction errors."""
    table = headed(
        "RMS prediction error of the measured outputs",
        *("output", "samples ahead", f"time ahead ({unit})", "from the estimate", "copying the last value"),
        numbers=4,
    )
    for one in each:
        ahead = ("all, open loop", "") if one.ahead is None else (str(one.ahead), f"{one.ahead * dt:g}")
        table.add_row(one.output, *ahead, f"{one.model:.4g}", "" if one.copying is None else f"{one.copying:.4g}")
    lost = {one.output: one.rejected for one in each if one.rejected}
    said = [f"{name}: {count} that the observer rejected, not compared" for name, count in lost.items()]
    return Group(table, *map(Text, said), "")


def fitted(result: Fit, notes: Iterable[str]) -> RenderableType:
    """Fitted parameters, how well the outputs are followed, and what that is worth; `notes` on the records."""
    parts = headed("fitted parameters", "name", "value", "standard error", "before", "unit", numbers=4)
    for one in result.parameters:
        spread = "at its end" if one.at else _spread(one.deviation)
        parts.add_row(one.name, f"{one.value:.5g}", spread, f"{one.nominal:.5g}", Text(one.unit))
    for one in result.lags:
        parts.add_row(f"lag of {one.name}", f"{one.value:.5g}", _spread(one.deviation), "", Text(one.unit))
    for one in result.offsets:
        parts.add_row(f"offset of {one.name}", f"{one.value:.5g}", _spread(one.deviation), "0", Text(one.unit))
    for what, levels in zip(("process noise of", "noise of a sample of"), result.noise, strict=True):
        for name, level in levels.items():
            parts.add_row(f"{what} {name}", f"{level:.3g}", "", "", "density" if levels is result.noise[0] else "")
    follows = headed(_ALONG[result.by], "output", "fitted", "before", "Ljung-Box", "limit", numbers=5)
    for name, error in result.error.items():
        test = result.whiteness[name]
        white = ("", "") if test is None else (f"{test.statistic:.4g}", f"{test.limit:.4g}")
        follows.add_row(name, f"{error:.4g}", f"{result.unfitted[name]:.4g}", *white)
    return Group(parts, "", follows, *map(Text, (*notes, *result.notes())), "")


_ALONG = {
    "simulation": "RMS error of the outputs along the record, from its first state; Ljung-Box tests whiteness",
    "prediction": "RMS error of predictions one sample ahead along the record; Ljung-Box tests whiteness",
}


def _spread(deviation: float) -> str:
    return f"{deviation:.2g}" if math.isfinite(deviation) else "not told"


def report(read: Report, begins: Mapping[str, float] | None = None) -> RenderableType:
    """What was found in a log; `begins`: the states that it gives the estimate to start from."""
    lines = list(read.sentences())
    if begins:
        at = ", ".join(f"{name} = {value:g}" for name, value in begins.items())
        lines.append(f"the estimate starts at {at}, and elsewhere where the observer does")
    return Group(Text(read.path, style="bold"), *(Text(f"  {said}") for said in lines), "")


def hidden(errors: Mapping[str, float | None], states: Sequence[Signal]) -> list[RenderableType]:
    """Errors of states whose truth was measured, if any."""
    units = {x.name: Text(x.unit) for x in states}
    rows = ((name, cell(error) or "nothing measured", units[name]) for name, error in errors.items())
    return filled(headed("RMS error of the estimate, by the truth", "state", "error", "unit", rows=rows))


def consistent(whole: Consistency, notes: Iterable[str]) -> RenderableType:
    """Whether innovations and errors are as large as the observer takes them to be, and white; `notes` on the run."""
    known = any(one.nis is not None for one in whole.outputs)
    says = "NIS is 1 where they are as large as the observer takes them to be; " if known else ""
    sure = ("NIS", "its 95 % band", "beyond 2 sigma") if known else ()
    title = f"innovations: {says}Ljung-Box tests whiteness"
    table = headed(title, "output", "samples", "RMS", *sure, "Ljung-Box", "limit", numbers=4 + len(sure))
    for one in whole.outputs:
        share = "" if one.outside is None else f"{100 * one.outside:.3g} %"
        size = (cell(one.nis), _band(one.band), share) if known else ()
        test = one.whiteness
        white = ("", "") if test is None else (f"{test.statistic:.4g}", f"{test.limit:.4g}")
        table.add_row(one.output, f"{one.count}", cell(one.rms), *size, *white)
    lines = [
        f"NEES of {', '.join(one.states)}: {one.nees:.4g}, its 95 % band {_band(one.band)}, from {one.count} samples "
        f"of which {one.alike:.3g} tell as much as one"
        for one in [whole.states]
        if one is not None
    ]
    return Group(table, *map(Text, (*lines, *notes)), "")


def from_double(each: Sequence[Difference], time: str) -> list[RenderableType]:
    """How far a run in float is from double, if it is one."""
    title = "in float, the bits that fly: the largest difference from double"
    columns = ("state", "difference", "unit", f"at ({time})", "share", "of its")
    rows = (
        (one.state, f"{one.largest:.3g}", Text(one.unit), f"{one.t:.4g}", f"{one.share:.2g}", one.of) for one in each
    )
    return filled(headed(title, *columns, rows=rows))


def _band(ends: tuple[float, float] | None) -> str:
    return "" if ends is None else f"{ends[0]:.4g} .. {ends[1]:.4g}"


def without(refused: Mapping[str, str], title: str = "without gains") -> list[RenderableType]:
    """Why observers have no gains, or no step, if any."""
    return filled(headed(title, "observer", "why", rows=((name, Text(why)) for name, why in refused.items())))


def cell(value: float | None) -> str:
    """A number; empty where there is none."""
    return "" if value is None or math.isnan(value) else f"{value:.4g}"
