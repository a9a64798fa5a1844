"""The options that override a model's file: form, method, period, precision, parameters, tuning."""

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple

from hgogen.errors import BadArgument, nearest
from hgogen.registry import cases

if TYPE_CHECKING:
    from hgogen.call import CallableStep


SEEDS = 1000  # noise seeds of a trial, at most


class UnknownCase(BadArgument):
    """The error for a form, method or target that does not exist."""


class Option(NamedTuple):
    """The help text of a command-line option, and the name of its value in that text."""

    help: str
    metavar: str | None = None


_REAL = Option("The precision; by default C is written in float, and Python runs in double.")
_GUARDS = Option("all, or none: a step without clamps, fault checks and restarts.")
_PREFER = Option("speed, or flash: a shorter and slower program, which uses loops.")
_REPORT = Option("Further functions, with commas: sigma, age, innovation.", "NAMES")
_TUNING = Option("A file of tunings that `hgogen tune` wrote; the recommended one is used.", "FILE")


@dataclass(frozen=True)
class Setting:
    """The settings of a model that command-line options override; None keeps the file's own setting. `dt` may be a pair
    of the shortest and the longest time between two calls."""

    form: Annotated[str | None, Option("The form, instead of the model's.", "NAME")] = None
    method: Annotated[str | None, Option("The method, instead of the model's.", "NAME")] = None
    dt: Annotated[float | tuple[float, float] | None, Option("The sampling period, in the model's unit of time.")] = (
        None
    )
    real: Annotated[Literal["float", "double"] | None, _REAL] = None
    guards: Annotated[Literal["all", "none"] | None, _GUARDS] = None
    prefer: Annotated[Literal["speed", "flash"] | None, _PREFER] = None
    report: Annotated[str | None, _REPORT] = None
    parameters: Annotated[Path | None, Option("A file of parameter values that `hgogen fit` wrote.", "FILE")] = None
    tuning: Annotated[Path | None, _TUNING] = None

    def __bool__(self) -> bool:
        return bool(self.words)

    @property
    def words(self) -> tuple[str, ...]:
        """The command-line options and values that give these settings, such as "--dt", "0.01"."""
        return tuple(f"--{name} {value}" for name, value in asdict(self).items() if value is not None)

    @property
    def reports(self) -> tuple[str, ...] | None:
        """The names in `report`, which commas separate; None if `report` is not set."""
        return None if self.report is None else tuple(filter(None, map(str.strip, self.report.split(","))))

    @property
    def longest(self) -> float | None:
        """The period `dt`, or the longest time between two calls; None if `dt` is not set."""
        return self.dt[1] if isinstance(self.dt, tuple) else self.dt

    def demand(self) -> None:
        """Raise `UnknownCase` for an unknown form or method."""
        demand_known("form", self.form, cases("forms"))
        demand_known("method", self.method, cases("methods"))

    def on(self, step: "CallableStep") -> "CallableStep":
        """Return the step rebuilt with these settings, as far as they concern steps. Raises: as `hg.sample` and the
        observer do."""
        if not self:
            return step
        from hgogen import forms, methods  # slow to import

        form = getattr(forms, self.form) if self.form else None
        method = getattr(methods, self.method) if self.method else None
        return step.rebuilt(form, method, self.dt, self.real, self.guards, self.prefer, self.reports)


AS_WRITTEN = Setting()


def demand_known(kind: str, name: str | None, known: Iterable[str]) -> None:
    """Raise `UnknownCase` for a `name` that is not in `known`; None passes. `kind`: the word for it in the message,
    such as "form"."""
    if name is None or name in known:
        return
    fix = nearest(name, known, f"there are {', '.join(known)}")
    raise UnknownCase(f"--{kind} {name[:60]}:", f"there is no such {kind}; {fix}")
