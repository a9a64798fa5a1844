"""The options that override a model's file: form, method, period, precision, parameters, tuning."""

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from hgogen.errors import BadArgument, nearest
from hgogen.registry import cases

if TYPE_CHECKING:
    from hgogen.call import CallableStep
    from hgogen.emit.syntax import Real
    from hgogen.part import Guards, Prefer


SEEDS = 1000  # noise seeds of a trial, at most


class UnknownCase(BadArgument):
    """An unknown form, method or target."""


@dataclass(frozen=True)
class Setting:
    """The overridden settings of a model: a form and a method by name, the period `dt` in the model's unit of time, or
    the shortest and the longest time between two calls, the precision `real`, "float" or "double", the `guards`, "all"
    or "none", the preference `prefer`, "speed" or "flash", the names of reports in `report`, a file of values of
    `parameters` and one of a `tuning`; None for the file's own setting."""

    form: str | None = None
    method: str | None = None
    dt: float | tuple[float, float] | None = None
    real: "Real | None" = None
    guards: "Guards | None" = None
    prefer: "Prefer | None" = None
    report: str | None = None
    parameters: Path | None = None
    tuning: Path | None = None

    def __bool__(self) -> bool:
        return bool(self.words)

    @property
    def words(self) -> tuple[str, ...]:
        """The command-line options and values with these settings, such as "--dt"."""
        return tuple(f"--{name} {value}" for name, value in asdict(self).items() if value is not None)

    @property
    def reports(self) -> tuple[str, ...] | None:
        """The names in `report`, which are separated by commas."""
        return None if self.report is None else tuple(filter(None, map(str.strip, self.report.split(","))))

    @property
    def longest(self) -> float | None:
        """The period `dt`, or the longest time between two calls."""
        return self.dt[1] if isinstance(self.dt, tuple) else self.dt

    def demand(self) -> None:
        """Raise `UnknownCase` for an unknown form or method."""
        demand_known("form", self.form, cases("forms"))
        demand_known("method", self.method, cases("methods"))

    def on(self, step: "CallableStep") -> "CallableStep":
        """Return the step rebuilt with the settings that concern steps. Raises: as `hg.sample` and the observer do."""
        if not self:
            return step
        from hgogen import forms, methods  # slow to import

        form = getattr(forms, self.form) if self.form else None
        method = getattr(methods, self.method) if self.method else None
        return step.rebuilt(form, method, self.dt, self.real, self.guards, self.prefer, self.reports)


AS_WRITTEN = Setting()


def demand_known(kind: str, name: str | None, known: Iterable[str]) -> None:
    """Raise `UnknownCase` for a name that is not in `known`."""
    if name is None or name in known:
        return
    fix = nearest(name, known, f"there are {', '.join(known)}")
    raise UnknownCase(f"--{kind} {name[:60]}:", f"there is no such {kind}; {fix}")
