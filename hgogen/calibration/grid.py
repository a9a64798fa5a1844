"""The search for the gains of an observer that predict records best.

What an observer makes of the numbers of a `Scale` is the rule beside it. Here these numbers come from the record: Q and
R where the likelihood has a maximum, theta and the longest time from a grid, refined once round the best, and then
the shape of poles and filters.
"""

import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from hgogen import methods
from hgogen import observers as every
from hgogen.calibration.likelihood import Likelihood
from hgogen.calibration.score import Judge, chosen
from hgogen.calibration.tuned import Tuned
from hgogen.call import CallableStep, sample
from hgogen.check import refuted
from hgogen.errors import BadArgument, HgogenError, nearest
from hgogen.form import Form
from hgogen.identification.motion import paced
from hgogen.identification.records import Log
from hgogen.modelfiles.arguments import value
from hgogen.modelfiles.first import First
from hgogen.starting import Gains, Scale, Starting, gains_of, scale, two
from hgogen.step import StepMayFail
from hgogen.which_forms import Row

Array = np.ndarray
STEEPEST = 2.0  # 1/(theta dt), at least
GRID = 9  # values of theta, or of the longest time
LONG = np.geomspace(1e-2, 1e2, GRID)  # of the longest time
SHAPES: dict[str, tuple[float, ...]] = {"spread": (2, 4), "corner": (1.5, 6)}  # of poles, and of filters
FASTER = (1.0, 1.4)  # times theta, with another shape


@dataclass(frozen=True, eq=False)
class Task:
    """What is tuned to what."""

    records: tuple[Log, ...]
    judge: Judge
    sampling: Mapping[str, str]
    each: Callable[[str], None]
    likelihoods: dict[str, Likelihood] = field(default_factory=dict)

    @property
    def dt(self) -> float:
        """Of the records."""
        return self.records[0].dt

    def tuned(self, name: str, rows: Sequence[Row]) -> Tuned | str:
        """On the first form that admits the observer with gains of its rule, or why there is none."""
        refusals = ["the plant is in none of its forms"]
        for row in rows:
            if row.form is None or refuted(row.form.checks):
                continue
            if len(row.form.system.inputs) > self.records[0].u.shape[1]:
                refusals.append("its form asks for derivatives of inputs, which are in no record")
                continue
            search = Search(self, name, row, scale(row.form, self.dt))
            gains = gains_of(getattr(every, name), search.base)
            if isinstance(gains, str):
                return gains
            if (best := search.search()) is not None:
                return best
            refusals += search.refusals[:1]
        return refusals[:2][-1]

    def step(self, name: str, form: Form, gains: Gains) -> CallableStep:
        """Of an observer at the period of the records. Raises: as the observer and `sample` do."""
        return step_of(name, form, gains, self.dt, self.sampling)

    def likelihood(self, row: Row, form: Form, base: Scale) -> Likelihood:
        """On a form, made once for all observers: two forms of one kind have other coordinates."""
        if row.name not in self.likelihoods:
            steps, _ = paced(form.system, self.dt)
            every_start = partial(self.each, "likelihood")
            made = Likelihood(form, self.records, base, self.sampling["between"], steps, every_start)
            self.likelihoods[row.name] = made
        return self.likelihoods[row.name]


class UnknownObserver(BadArgument):
    """A name of no observer."""


def observers_named(names: Iterable[str] | None) -> tuple[str, ...]:
    """The names, each once, by default all there are. Raises: `UnknownObserver`."""
    known = tuple(every.__all__)
    for name in names or ():
        if name not in known:
            fix = nearest(name, known, f"there are {', '.join(known)}")
            raise UnknownObserver(f"observer {name[:60]!r}", f"is none; {fix}")
    return known if names is None else tuple(dict.fromkeys(names))


def reasons(refused: Mapping[str, object]) -> str:
    """Why there are no gains, each reason once."""
    names: dict[str, list[str]] = {}
    for name, reason in refused.items():
        names.setdefault(str(reason), []).append(name)
    return "; ".join(f"{', '.join(those)}: {reason}" for reason, those in names.items())


def step_of(observer: str, form: Form, gains: Gains, dt: float, sampling: Mapping[str, Any]) -> CallableStep:
    """Of an observer with gains as a tuning holds them, `method`, `between` and `real` of `sampling` too; that it may
    fail is left to what judges it.

    Raises: as the observer and `sample` do.
    """
    method = getattr(methods, sampling.get("method", "continuous_discrete"))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StepMayFail)
        made = getattr(every, observer)(form, **{key: value(key, entry) for key, entry in gains.items()})
        options = {key: entry for key, entry in sampling.items() if key != "method"}
        return sample(made, method, dt, **options)


def thetas(theta: float, dt: float) -> list[float]:
    """A grid from a thirtieth of a theta to what steps of dt take."""
    least, largest = max(1.0, theta / 30), 1 / (STEEPEST * dt)
    return [two(each) for each in np.geomspace(least, max(largest, 2 * least), GRID)]


@dataclass(frozen=True, eq=False)
class Search:
    """The scales tried for an observer on a form, from the scale `base` on."""

    task: Task
    name: str
    row: Row
    base: Scale
    scales: list[Scale] = field(default_factory=list)
    steps: list[First] = field(default_factory=list)
    refusals: list[str] = field(default_factory=list)

    def search(self) -> Tuned | None:
        """The best scale of the grid, and of those between it and its neighbours; None where none makes a step."""
        errors = self._tried(self._grid())
        if errors:
            for others in (self._between, self._shaped):
                best, _ = chosen(errors)
                errors |= self._tried(others(best, errors))
        if not errors:
            return None
        best, judged = chosen(errors)
        filters = self._reads(process={name: 2 * q for name, q in self.base.process.items()})
        likelihood = self._likelihood if filters else None
        maxima = likelihood.maxima if likelihood else ()
        noise = next((one for one in maxima if one.sample is self.scales[best].noise), None)
        tried = tuple((self.scales[k], float(np.sqrt(e.mean()))) for k, e in errors.items())
        return Tuned(
            self.name, self.steps[best], self.scales[best], noise, likelihood, self.task.sampling, judged, tried
        )

    def _tried(self, scales: Iterable[Scale]) -> dict[int, Array]:
        """E_s of each scale that makes a step which is not lost, by its number."""
        errors = {}
        for numbers in scales:
            if (first := self._first(numbers)) is not None:
                self.scales.append(numbers)
                self.steps.append(first)
                errors[len(self.steps) - 1] = self.task.judge.errors(first.step)
            self.task.each(self.name)
        return {k: e for k, e in errors.items() if np.isfinite(e).all()}

    def _grid(self) -> list[Scale]:
        """What the rule reads is varied."""
        scales = [self.base]
        if self._reads(theta=2 * self.base.theta):
            values = thetas(self.base.theta, self.task.dt)
            scales = [replace(one, theta=theta) for one in scales for theta in values]
        if self._reads(longest=2 * self.base.longest):
            scales = [replace(one, longest=one.longest * factor) for one in scales for factor in LONG]
        if self._reads(noise={name: 2 * sigma for name, sigma in self.base.noise.items()}):
            scales = [replace(one, **noise.on(one)) for one in scales for noise in self._likelihood.maxima]
        return scales

    def _between(self, best: int, tried: Iterable[int]) -> Iterator[Scale]:
        """Half way from the best theta, and the best longest time, to those next to it."""
        middle = self.scales[best]
        varied: dict[str, Callable[[float], Scale]] = {
            "theta": lambda value: replace(middle, theta=value),
            "longest": lambda value: replace(middle, longest=value),
        }
        for name, of in varied.items():
            value, every_value = getattr(middle, name), [getattr(self.scales[k], name) for k in tried]
            neighbours = (
                sorted(o for o in every_value if o < value)[-1:] + sorted(o for o in every_value if o > value)[:1]
            )
            yield from (of(two((value * other) ** 0.5)) for other in neighbours)

    def _shaped(self, best: int, tried: Iterable[int]) -> Iterator[Scale]:
        """Other shapes of poles and filters than the best scale's, with a larger theta too."""
        middle, largest = self.scales[best], 1 / (STEEPEST * self.task.dt)
        every_theta = {min(two(factor * middle.theta), max(middle.theta, largest)) for factor in FASTER}
        for name, values in SHAPES.items():
            if self._reads(**{name: values[0]}):
                shapes: Iterable[dict[str, Any]] = ({name: value} for value in values)
                yield from (replace(middle, theta=theta, **shape) for shape in shapes for theta in sorted(every_theta))

    @property
    def _likelihood(self) -> Likelihood:
        return self.task.likelihood(self.row, self._form, self.base)

    @property
    def _form(self) -> Form:
        assert self.row.form is not None
        return self.row.form

    def _reads(self, **values: Any) -> bool:
        """Whether gains change with a number."""
        observer = getattr(every, self.name)
        return gains_of(observer, replace(self.base, **values)) != gains_of(observer, self.base)

    def _first(self, numbers: Scale) -> First | None:
        gains = gains_of(getattr(every, self.name), numbers)
        if isinstance(gains, str):
            self.refusals.append(gains)
            return None
        try:
            step = self.task.step(self.name, self._form, gains)
        except HgogenError as error:
            self.refusals.append(str(error))
            return None
        return First(self.name, self.row, Starting(gains, self.task.dt), step)
