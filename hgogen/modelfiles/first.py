"""The first step of an observer that a tuning says nothing of: its starting gains, on the first form that admits it."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

from hgogen import forms, observers
from hgogen.call import CallableStep, sample
from hgogen.check import refuted
from hgogen.errors import HgogenError
from hgogen.reading.given import BadGain
from hgogen.starting import Starting, starting_gains
from hgogen.step import StepTooLong
from hgogen.system import System
from hgogen.theorem import Convergence, convergence
from hgogen.which_forms import Row, Survey, survey


@dataclass(frozen=True)
class First:
    """An observer by name, the form that admits it without any accepted refutation, its starting gains, its step."""

    observer: str
    row: Row
    starting: Starting
    step: CallableStep

    @property
    def known(self) -> Convergence | None:
        """What is known of its convergence, None where no theorem covers it."""
        observer = self.step.observer
        return None if observer.form.kind == "original" else convergence(observer.name, observer.checks)

    def table(self, name: str = "") -> Mapping[str, Any]:
        """The tuning that makes the same step, of a name, by default the observer's."""
        kind = {"kind": self.observer} if name not in ("", self.observer) else {}
        form = {"kind": self.row.kind, **self.row.options} if self.row.options else self.row.kind
        return {**kind, "form": form, **self.starting.gains, "dt": self.starting.dt}


@dataclass(frozen=True)
class NoFirst:
    """Why there is no first step; `ruled`: the observer's rule gives no gains, and no form refuses it; `too_long`: the
    period is, of an observer that takes the plant."""

    reason: str
    ruled: bool = False
    too_long: bool = False


def places(survey: Survey) -> Iterator[Row]:
    """Where an observer is asked, in order: the forms that say something of observability, the plant in its own
    coordinates, made when it comes to that, and the forms that say nothing of it."""
    yield from survey.candidates
    own = survey["original"]
    yield own if own.form else replace(own, form=forms.original(survey.plant))
    yield from (row for row in survey.silent if row.kind != own.kind)


def everywhere(plant: System, *, deep: bool = True) -> Iterator[Row]:
    """The places of a plant; those whose forms take seconds last, and only if `deep`. A plant is surveyed once."""
    yield from places(_surveyed(plant, False))
    if deep:
        yield from places(_surveyed(plant, True))


@lru_cache(maxsize=2)
def _surveyed(plant: System, deep: bool) -> Survey:
    return survey(plant, deep=deep)


def first(observer: str, rows: Iterable[Row], dt: float | None = None) -> First | NoFirst:
    """The first step of one of `hg.observers` at the sampling period `dt`, by default that of its starting gains."""
    make, refusals, skipped = getattr(observers, observer), list[NoFirst](), list[NoFirst]()
    for row in rows:
        if row.form is None or refuted(row.form.checks):
            # of a form that the survey did not ask, the first check that fails; else what the survey says of it
            failed = refuted(row.form.checks) if row.form and row.verdict is None else ()
            reasons = (f"{check.id} is refuted: {check.reason}" for check in failed)
            skipped.append(NoFirst(next(reasons, f"the plant is not in the form {row.name}: {row.why}")))
            continue
        starting = starting_gains(row.form, make, dt=dt)
        if not starting:
            return NoFirst(starting.none, ruled=True)
        try:
            step = sample(make(row.form, **starting.gains), dt=starting.dt)
        except HgogenError as error:
            # without what to take instead, such as another form: all are asked
            reason = str(replace(error, fix="") if isinstance(error, BadGain) else error)
            refusals.append(NoFirst(reason, too_long=isinstance(error, StepTooLong)))
        else:
            return First(observer, row, starting, step)
    return next(iter((*refusals, *skipped)), NoFirst("no form takes the plant"))
