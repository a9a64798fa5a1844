"""Observers on a plant by name, with the gains that a model's `tuning` holds.

    tuning = {"high_gain": {"theta": 20, "poles": (-1, -1)}}      # Python: an observer's name, and its arguments

    [tuning.high_gain]                # plain text; a complex pole is [re, im]
    theta = 20
    poles = [[-1, 0.5], [-1, -0.5]]   # a list for each chain of integrators of a form with several
    form = "triangular"               # one of hg.forms (the default; that of ekf and kalman is "original"), or with
                                      # arguments {kind = "original", order = ["x2", "x1"]}, or the form of another
                                      # tuning, {of = "filter"}
    method = "rk4"                    # one of hg.methods
    dt = 1e-3                         # s; by default that of the model's own step; [8e-4, 1.2e-3] where it varies
    between = "line"                  # or "hold"
    real = "double"                   # or "float", the precision of the step
    periods = {y = 1e-2}              # s; between two samples of a slower sensor, by default dt
    report = ["sigma", "age"]         # functions that say how sure the estimate is
    delays = {y = 5}                  # largest delay of a sample of y in periods dt, see hg.delayed

    [tuning.filter]                   # kind: one of hg.observers, if the name is none of them
    kind = "riccati"
    Q = {x1 = 1, x2 = 1}              # by the names of the form's coordinates, or a list in their order
    R = 1
    theta = {kind = "adaptive", theta_1 = 4, mu = [0.16, 0.32], innovation = {kind = "staggered", d = 1}}

    [tuning.bank]                     # an observer around another one, which has its own tuning, with its method, dt,
                                      # between, periods and real unless it has its own
    member = "filter"
    count = 5

In Python `form` may be a function of the plant, and a value may be the object that the text names.
"""

import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from inspect import Parameter, signature
from pathlib import Path
from typing import Any, TypeVar

from hgogen import forms, methods, observers
from hgogen.call import CallableStep, sample
from hgogen.check import Refuted, refuted
from hgogen.errors import HgogenError, is_ignored, nearest
from hgogen.estimators import innovation, theta
from hgogen.estimators.synonyms import SYNONYMS
from hgogen.form import Form
from hgogen.modelfiles.setting import AS_WRITTEN, Setting
from hgogen.observer import STARTS, Observer
from hgogen.reading import files
from hgogen.reading.files import READERS
from hgogen.reading.given import BadGain
from hgogen.reading.text_model import NUMBER, TABLE, TEXT, BadModelFile, demand_keys
from hgogen.signal import plural
from hgogen.starting import Starting, longest, starting_gains
from hgogen.step import StepMayFail, StepTooLong
from hgogen.stepping.delays import delayed
from hgogen.system import System
from hgogen.theorem import Convergence
from hgogen.which_forms import Row, Survey, survey

# arguments of `sample` besides method and dt
_OPTIONS = ("substeps", "between", "periods", "guards", "prefer", "first", "real", "report")
_SAMPLING = ("method", "dt", "delays", *_OPTIONS)
PLACED = ("kind", "form", "member", *_SAMPLING)  # all other keys are the observer's arguments
Result = TypeVar("Result")
Start = Callable[[Form], Mapping[str, float]]
TYPES = {
    "dt": NUMBER,
    "substeps": NUMBER,
    "delays": TABLE,
    **dict.fromkeys(("kind", "between", "guards", "prefer", "first", "real"), TEXT),
}


@dataclass(frozen=True)
class Tuning:
    """The tunings of a plant by name, each a table with an observer and its gains. `default`: the name of the tuning in
    the table `observer`; `setting`: command-line options that override the tables; `in_file`: whether a tuning is in
    the model's `file`, and not in a separate file of tunings."""

    file: str
    plant: System
    tables: Mapping[str, Mapping[str, Any]]
    default: str = ""
    setting: Setting = AS_WRITTEN
    in_file: Callable[[str], bool] = lambda name: True

    def where(self, name: str) -> str:
        """Return the keys that lead to a tuning's table in its file, such as "tuning.high_gain", for messages."""
        if not self.in_file(name):
            return f"{self.setting.tuning}, tuning.{name}"
        return "observer" if name == self.default else f"tuning.{name}"

    def step(
        self, name: str, default: Callable[[], float], dt: float | None = None, start: Start | None = None
    ) -> CallableStep:
        """Return the step of a tuning at the period `dt` (s), else at the table's, else at that which `default`
        returns; `start` as in `observer`. Raises: `BadModelFile` for an invalid table; `Refuted`."""
        where, table = self.where(name), self._sampling(name)
        method_name = self.setting.method or table.get("method", "continuous_discrete")
        method = self._case(f"{where}.method", methods, method_name)
        observer, delays = self.observer(name, start=start), table.get("delays", {})
        if delays:
            observer = self._refusals(f"{where}.delays", lambda: delayed(observer, **delays))
        periods = (dt, self.setting.dt, table.get("dt"))
        period = next((each for each in periods if each is not None), None)
        period = default() if period is None else period
        if observer.at_period is not None and "dt" in table and not self.plant.discrete:
            observer = replace(observer, process_dt=longest(table["dt"]))  # of process noise, whatever the step's dt
        options = {key: table[key] for key in _OPTIONS if key in table}
        if period is not table.get("dt"):  # a period that overrides a pair
            options.pop("substeps", None)
        setting = self.setting
        overriding = {
            "real": setting.real,
            "guards": setting.guards,
            "prefer": setting.prefer,
            "report": setting.reports,
        }
        options |= {key: value for key, value in overriding.items() if value is not None}
        return self._refusals(where, lambda: sample(observer, method, period, **options))

    def observer(self, name: str, around: tuple[str, ...] = (), start: Start | None = None) -> Observer:
        """Return the observer of the tuning `name`. `around`: the tunings whose observers contain this one as a member;
        `start`: a function that returns the observer's argument `initial` for its form, in place of the tuning's own.
        Raises: as `step`."""
        where, table, gains = self.where(name), self.table(name), self.gains(name)
        make = self._case(f"{where}.kind", observers, table.get("kind", name))
        self._arguments(where, make, gains)
        if "member" in signature(make).parameters:
            base: Any = self._member(name, table, (*around, name), start)
        elif "member" in table:
            raise BadModelFile(self.file, f"{where}.member", f"{make.__name__} is no observer around another one")
        else:
            base = self.form(name)
            if start is not None and isinstance(base, Form):
                gains = {key: value for key, value in gains.items() if key not in STARTS}
                gains |= {"initial": start(base)}
        if "poles" in gains:
            gains = {**gains, "poles": poles(gains["poles"], len(getattr(base, "leads", ())))}
        observer: Observer = self._refusals(where, lambda: make(base, **gains))
        return observer

    def form(self, name: str) -> Any:
        """Return the form of the tuning `name`, whose observer has no member. Raises: as `step`."""
        entry, where = self.setting.form or self._form_entry(name), f"{self.where(name)}.form"
        passed = [name]
        while isinstance(entry, Mapping) and "of" in entry:
            passed.append(str(entry["of"]))
            if passed[-1] not in self.tables or passed[-1] in passed[:-1]:
                raise BadModelFile(self.file, f"{where}.of", f"names {passed[-1]!r:.60}, no tuning that has a form")
            entry = self._form_entry(passed[-1])
        table = dict(entry) if isinstance(entry, Mapping) else {"kind": entry}
        make = self._case(where, forms, table.pop("kind", "original" if self.plant.discrete else "triangular"))
        options = {key: tuple(value) if isinstance(value, list) else value for key, value in table.items()}
        if callable(make):
            self._arguments(where, make, options)
        return self._refusals(where, lambda: make(self.plant, **options))

    def _form_entry(self, name: str) -> Any:
        table = self.table(name)
        known = SYNONYMS.get(str(table.get("kind", name)))
        usual = "original" if self.plant.discrete else known.form if known else "triangular"
        return table.get("form", usual)

    @property
    def synonyms(self) -> Iterator[str]:
        """A sentence for each tuning whose kind is a textbook name of another observer, as ekf is of riccati."""
        for name, kind in self._called.items():
            if self._is_synonym(kind):
                yield f"{self.where(name)}: {SYNONYMS[kind].sentence}"

    @property
    def kinds(self) -> dict[str, str]:
        """The name of each tuning's observer in `hg.observers`, by the tuning's name."""
        return {
            name: SYNONYMS[kind].observer if self._is_synonym(kind) else kind for name, kind in self._called.items()
        }

    def with_textbook_name(self, name: str) -> "Tuning":
        """Return the tunings; if one of them is the observer `name` by another name, as `riccati` at theta = 1 is
        `ekf`, it is also added under this name."""
        tables = {other: table for other, table in self.tables.items() if isinstance(table, Mapping)}
        for other, table in tables.items() if name not in self.tables else ():
            if self._is_one(name, kind := self._called[other], table):
                return replace(self, tables={**self.tables, name: {"kind": kind, **table}})
        return self

    def _is_one(self, name: str, kind: str, table: Mapping[str, Any]) -> bool:
        if not self._is_synonym(name):
            return self._is_synonym(kind) and SYNONYMS[kind].observer == name
        known = SYNONYMS[name]
        fixed = all(table.get(key, entry) == entry for key, entry in known.fixed.items())
        return kind == name or (kind == known.observer and fixed)

    @property
    def _called(self) -> dict[str, str]:
        tables = self.tables.items()
        return {name: str(table.get("kind", name)) if isinstance(table, Mapping) else name for name, table in tables}

    def _is_synonym(self, kind: str) -> bool:
        return kind in SYNONYMS and not (self.plant.discrete and kind == "luenberger")

    def period(self, name: str) -> float:
        """Return the sampling period dt (s) of a tuning, the longest if dt varies. Raises: `BadModelFile` if there is
        none."""
        table = self._sampling(name)
        if "dt" not in table:
            unit = plural(self.plant.time)
            reason = f"the key 'dt' is missing; add dt, the time in {unit} between two calls of the observer"
            raise BadModelFile(self.file, self.where(name), reason)
        return longest(table["dt"])

    def gains(self, name: str) -> Mapping[str, Any]:
        """Return the arguments of the observer in a tuning, by name. Raises: `BadModelFile`."""
        entries = {key: value for key, value in self.table(name).items() if key not in PLACED}
        return self._refusals(self.where(name), lambda: {key: value(key, entry) for key, entry in entries.items()})

    def table(self, name: str) -> Mapping[str, Any]:
        """Return the table of a tuning after validation. Raises: `BadModelFile` for an invalid name, or values of wrong
        types."""
        table, where = self.tables[name], self.where(name)
        if not isinstance(table, Mapping):
            kind = type(table).__name__
            raise BadModelFile(self.file, where, f"is of type {kind}; write a table of the observer's arguments")
        if not name.isidentifier():
            raise BadModelFile(self.file, where, "must be a name of letters, digits and underscores")
        self._refusals(where, lambda: files.demand_file_name(name))
        if twins := [key for key in self.tables if key != name and files.name_key(key) == files.name_key(name)]:
            raise BadModelFile(self.file, where, f"{twins[0]} is the same name on some systems; rename one of the two")
        needed = "kind" if name == self.default else None
        typed = {key: table[key] for key in TYPES if key in table}
        pair = typed.pop("dt") if isinstance(typed.get("dt"), list) else None
        if pair is not None and len(pair) != 2:
            raise BadModelFile(self.file, f"{where}.dt", "must be a time, or the shortest and the longest one")
        for end in pair or ():
            demand_keys(self.file, where, {"dt": end}, TYPES)
        demand_keys(self.file, where, typed, TYPES, needed)
        return table

    def _sampling(self, name: str) -> Mapping[str, Any]:
        sampling: dict[str, Any] = {}
        passed: list[str] = []
        while name in self.tables and name not in passed:
            table = self.table(name)
            sampling = {key: table[key] for key in _SAMPLING if key in table} | sampling
            passed.append(name)
            name = str(table.get("member", ""))
        return sampling

    def _member(self, name: str, table: Mapping[str, Any], around: tuple[str, ...], start: Start | None) -> Observer:
        where, member = f"{self.where(name)}.member", table.get("member")
        others = [other for other in self.tables if other not in around]
        if member not in others:
            listed = f"the other tunings are {', '.join(others)}" if others else "write another tuning"
            raise BadModelFile(self.file, where, f"is {member!r}, which must be the name of another tuning; {listed}")
        return self.observer(str(member), around, start)

    def _case(self, where: str, folder: Any, name: Any) -> Any:
        if not isinstance(name, str):
            return name
        if name not in folder.__all__ and not (folder is observers and name in SYNONYMS):
            known = nearest(name, folder.__all__, f"there are {', '.join(folder.__all__)}")
            raise BadModelFile(self.file, where, f"there is no {name[:60]!r}; {known}")
        return getattr(folder, name)

    def _arguments(self, where: str, make: Callable[..., Any], gains: Iterable[str]) -> None:
        for key, reason in faults(make, gains, PLACED, first=1):
            raise BadModelFile(self.file, f"{where}.{key}" if key else where, reason)

    def _refusals(self, where: str, function: Callable[[], Result]) -> Result:
        try:
            return function()
        except Refuted as error:
            plain, at = Path(self.file).suffix in READERS, f"{self.file}, {where}"
            raise replace(error, where=at, plain=plain, other=self._other(error.form)) from None
        except (HgogenError, TypeError, ValueError) as error:
            raise BadModelFile(self.file, where, str(error)) from None

    def _other(self, refused_form: Any) -> str:
        form = forms.state_affine(self.plant)
        if getattr(refused_form, "kind", "") == form.kind or not form.structured or refuted(form.checks):
            return ""
        return "The plant is state-affine, which is proved: kalman_like takes its form state_affine."


_VALUES: dict[str, tuple[Callable[..., Any], ...]] = {  # the functions that a table with `kind` may name, by argument
    "theta": (theta.constant, theta.decaying, theta.adaptive),
    "mu": (theta.smoothstep, theta.logistic),
    "innovation": (innovation.staggered, innovation.window),
}


def arguments(make: Callable[..., Any]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the names of an observer's arguments that a tuning's table may have: first all, then those without a
    default; the argument `member` comes first."""
    each = signature(make).parameters.values()
    return _names(p for p in each if p.kind is Parameter.KEYWORD_ONLY or p.name == "member")


def faults(
    make: Callable[..., Any], keys: Iterable[str], other_keys: Iterable[str] = (), first: int = 0
) -> Iterator[tuple[str, str]]:
    """Yield each of the `keys` that a function does not accept as an argument, with a sentence; then an empty key, with
    a sentence, for each missing argument. `other_keys`: valid keys of the same table, for suggestions; `first`: the
    number of arguments that do not come from the table."""
    known, needed = _names(list(signature(make).parameters.values())[first:])
    for key in keys:
        if key not in known:
            listed = f"its arguments are {', '.join(known)}" if known else "it takes none"
            fix = nearest(key, [*known, *other_keys], listed)
            yield key, f"{make.__name__} has no argument {key[:60]!r}; {fix}"
    for key in needed:
        if key not in keys:
            yield "", f"the key {key!r} is missing; {make.__name__} needs it"


def value(key: str, raw: Any) -> Any:
    """Return the value of an argument from the entry `raw` of a tuning's table: a table with `kind` is passed to the
    function of that name, such as `adaptive`; a list of thresholds `mu` becomes a tuple. Raises: `BadGain`, and the
    errors of the function."""
    if key in _VALUES and isinstance(raw, Mapping):
        makers = {make.__name__: make for make in _VALUES[key]}
        if raw.get("kind") not in makers:
            raise BadGain(f"{key} of kind {raw.get('kind')!r}", f"is none; the kinds are {', '.join(makers)}")
        make, options = makers[raw["kind"]], {name: entry for name, entry in raw.items() if name != "kind"}
        for _, reason in faults(make, options, ("kind",)):
            raise BadGain(f"in {key},", reason)
        return make(**{name: value(name, entry) for name, entry in options.items()})
    return tuple(raw) if key == "mu" and isinstance(raw, list) else raw


def poles(listed: Any, chains: int) -> Any:
    """Return poles from a table's list: a pair [re, im] is a complex pole. With several `chains` of integrators there
    is a list for each chain, and a pair of numbers in its place is two real poles."""
    if not isinstance(listed, list):
        return listed
    if chains > 1:
        return [poles(each, 1) for each in listed]
    numbers = (isinstance(pole, list) and all(type(part) in (int, float) for part in pole) for pole in listed)
    pairs = (one and len(pole) == 2 for one, pole in zip(numbers, listed, strict=True))
    return [complex(*pole) if pair else pole for pair, pole in zip(pairs, listed, strict=True)]


def _names(parameters: Iterable[Parameter]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    named = tuple(parameters)
    return tuple(p.name for p in named), tuple(p.name for p in named if p.default is Parameter.empty)


@dataclass(frozen=True)
class First:
    """A first step for a beginner: the name of the `observer`, the form in `row`, which admits the observer without
    accepting a refuted check, the starting gains `starting`, and the `step`."""

    observer: str
    row: Row
    starting: Starting
    step: CallableStep

    @property
    def convergence(self) -> Convergence | None:
        """The status of its convergence; None if no theorem covers it."""
        return self.step.observer.convergence

    def table(self, name: str = "") -> Mapping[str, Any]:
        """Return the tuning's table, from which an equal step can be built; `name`: that of the tuning, by default the
        observer's."""
        kind = {"kind": self.observer} if name not in ("", self.observer) else {}
        form = {"kind": self.row.kind, **self.row.options} if self.row.options else self.row.kind
        dt = self.starting.dt
        return {**kind, "form": form, **self.starting.gains, "dt": list(dt) if isinstance(dt, tuple) else dt}


@dataclass(frozen=True)
class NoFirst:
    """The reason why there is no first step; `ruled`: whether a form admits the observer, but its rule gives no
    starting gains; `too_long`: the error if a form admits the observer, but the period is too long."""

    reason: str
    ruled: bool = False
    too_long: StepTooLong | None = None


def places(survey: Survey) -> Iterator[Row]:
    """Yield the candidate forms of a survey in the order in which an observer tries them: forms that imply
    observability, the plant in its own coordinates (built only when reached), and the other forms."""
    yield from survey.candidates
    original_row = survey["original"]
    yield original_row if original_row.form else replace(original_row, form=forms.original(survey.plant))
    yield from (row for row in survey.silent if row.kind != original_row.kind)


def everywhere(plant: System, *, deep: bool = True) -> Iterator[Row]:
    """Yield the candidate forms of a plant; forms whose check takes seconds come last, and only if `deep`. Surveys are
    cached."""
    yield from places(_surveyed(plant, False))
    if deep:
        yield from places(_surveyed(plant, True))


@lru_cache(maxsize=2)
def _surveyed(plant: System, deep: bool) -> Survey:
    return survey(plant, deep=deep)


def _advised(
    make: Callable[..., Observer], form: Form, starting: Starting, fixed: bool
) -> tuple[Starting, CallableStep]:
    """Return the starting gains and their step. If the step may fail at their dt, which is not `fixed`, use the
    starting gains at the longest dt that is advised."""
    with warnings.catch_warnings():
        if not (fixed or is_ignored(StepMayFail)):
            warnings.simplefilter("error", StepMayFail)
        try:
            return starting, sample(make(form, **starting.gains), dt=starting.dt)
        except StepMayFail as limit:
            starting = starting_gains(form, make, dt=limit.take)
    return starting, sample(make(form, **starting.gains), dt=starting.dt)


def first(observer: str, rows: Iterable[Row], dt: float | None = None) -> First | NoFirst:
    """Return a first step of the observer with this name, on the first of the forms in `rows` that admits the observer;
    or the reason why there is none. `dt`: the sampling period, by default that of the starting gains, or the longest
    that is advised for the step if that is shorter."""
    make, refusals, skipped = getattr(observers, observer), list[NoFirst](), list[NoFirst]()
    for row in rows:
        if row.form is None or refuted(row.form.checks):
            # the first refuted check of a form that the survey skipped, else the survey's reason
            failed = refuted(row.form.checks) if row.form and row.verdict is None else ()
            reasons = (f"{check.id} is refuted: {check.reason}" for check in failed)
            skipped.append(NoFirst(next(reasons, f"the plant is not in the form {row.name}: {row.why}")))
            continue
        starting = starting_gains(row.form, make, dt=dt)
        if not starting:
            return NoFirst(starting.none, ruled=True)
        try:
            starting, step = _advised(make, row.form, starting, fixed=dt is not None)
        except HgogenError as error:
            # without the fix, such as another form: all forms are tried
            reason = str(replace(error, fix="") if isinstance(error, BadGain) else error)
            refusals.append(NoFirst(reason, too_long=error if isinstance(error, StepTooLong) else None))
        else:
            return First(observer, row, starting, step)
    return next(iter((*refusals, *skipped)), NoFirst("no form takes the plant"))
