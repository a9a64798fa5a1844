"""A model file: Python that defines `plant` and, where they apply, `step()`, `trial()` and `tuning`; or plain text."""

import linecache
import shlex
import sys
import traceback
from collections.abc import Callable, Mapping
from contextlib import redirect_stdout
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from hashlib import sha256
from os import fsencode
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, TypeVar

from hgogen import observers
from hgogen.call import CallableStep
from hgogen.check import Refuted
from hgogen.errors import BadArgument, HgogenError, nearest
from hgogen.estimators.synonyms import SYNONYMS
from hgogen.modelfiles.declarations import Bounds, NoBounds, bounds, stored, trial_of
from hgogen.modelfiles.json_file import put, read_tunings, read_values
from hgogen.modelfiles.place import PYTHON, NoModel, ends_python, listed, located, sentence
from hgogen.modelfiles.setting import AS_WRITTEN, Setting
from hgogen.modelfiles.tuning import NoFirst, Start, Tuning, arguments, everywhere, first
from hgogen.prove.dissipation import Dissipation
from hgogen.reading import files
from hgogen.reading.expression import Fold
from hgogen.reading.files import BYTES, READERS, Unread, content_of
from hgogen.reading.given import Misfit
from hgogen.reading.text_model import BadModelFile, read
from hgogen.registry import Displayed
from hgogen.rigor.box import box
from hgogen.starting import longest, per_sample
from hgogen.system import System
from hgogen.trial import Trial
from hgogen.which_forms import of

Returned = TypeVar("Returned")
_PYTHON = {
    "plant": "plant = hg.System(...)",
    "step": "def step(): return hg.sample(...)",
    "trial": "def trial(): return hgogen.trial.Trial(...)",
    "tuning": "'{observer}': {{...}} to tuning, with {arguments}",
}
_PLAIN = {
    "step": "an observer table, such as kind = 'high_gain', theta = 20, poles = [-1, -1], dt = 1e-3, "
    "or name one: --observer riccati",
    "trial": "a trial table, such as duration = 10, start = {x1 = 1}",
    "tuning": "a table [tuning.{observer}] with {arguments}",
}


@dataclass(eq=False)
class ModelFails(HgogenError):
    """The error for a model file, or a function in it, that raises an error."""

    text = "{path}, line {line}: {error}"
    path: str
    line: int
    error: str


class MissingPart(BadArgument):
    """The error for a model file without a required part, or with a wrong value under its name."""

    text = "{what}: {reason}"


@dataclass(frozen=True, eq=False)
class Model(Displayed):
    """A loaded model file.

    `module` has its parts, such as `plant` and `tuning`; `fixes`: for a part that is missing, the definition to add;
    `default`: the name of the tuning in the table `observer` of a plain-text model; `folds`: the texts of a plain-text
    model in which SymPy removed a part; `setting`: the user's settings of steps, which replace those of the file;
    `tables`: the user's tunings by name, which replace equal names in the file; `take`: the name of the tuning among
    them that the model's step uses.
    """

    name: str
    path: str
    module: ModuleType | SimpleNamespace
    fixes: Mapping[str, str]
    default: str = ""
    folds: tuple[Fold, ...] = ()
    setting: Setting = AS_WRITTEN
    tables: Mapping[str, Any] = field(default_factory=dict)
    take: str = ""

    def __repr__(self) -> str:
        return f"<model {self.name} in {self.path}>"

    def set(self, setting: Setting) -> "Model":
        """Return the model with the `setting` (a form, a method or a period of its steps, tunings, values of
        parameters) in place of the file's own, which is read again for parameters. Raises: `UnknownCase`; `BadFile`,
        `BadParameters`, `BadValue`; `Misfit` for a value that is no setting."""
        if not isinstance(setting, Setting):
            raise Misfit("set", setting, "a Setting, as of hgogen.modelfiles.setting")
        setting.demand()
        model = self if setting.parameters is None else self.valued(read_values(setting.parameters, self.plant))
        unchanged = (self.tables, self.take)
        tables, take = unchanged if setting.tuning is None else read_tunings(setting.tuning, self.plant)
        return replace(model, setting=setting, tables=tables, take=take)

    def valued(self, values: Mapping[str, float]) -> "Model":
        """Return the model with other values of its plant's parameters, by name; its file is read again. Raises:
        `BadValue`; `BadParameters` for parts of the file that depend on the plant while it is read."""
        fresh = load(self.path)
        names = vars(fresh.module)
        names.update(put(names, fresh.plant, values))
        return replace(fresh, setting=self.setting, tables=self.tables, take=self.take)

    def sampled(self, dt: float | tuple[float, float]) -> "Model":
        """Return the model with the sampling period `dt`, or the shortest and the longest, for its steps, and its
        present parameters."""
        return self.set(replace(self.setting, dt=dt, parameters=None))

    @property
    def plain(self) -> bool:
        """Whether the file is plain text, and not Python."""
        return Path(self.path).suffix in READERS

    @property
    def argument(self) -> str:
        """The word for the model in a command: its name where that alone finds its file, else the name of its file."""
        try:
            by_name = located(self.name).resolve() == Path(self.path).resolve()
        except NoModel:
            by_name = False
        return self.name if by_name else shlex.quote(Path(self.path).name)

    @property
    def plant(self) -> System:
        """The plant that the file defines. Raises: `MissingPart`."""
        plant = self._part("plant")
        if not isinstance(plant, System):
            raise MissingPart(self.path, f"plant is of type {type(plant).__name__}; make it an hg.System")
        return plant

    @property
    def dissipation(self) -> Dissipation | None:
        """V and mu with dV/de F + |dV/de G|^2/(2 mu^2) + |e|^2/2 < 0, as declared, or None. Raises: `MissingPart`."""
        if not self.has("dissipation"):
            return None
        try:
            return stored(self.plant, self.module.dissipation)
        except HgogenError as error:
            raise MissingPart(self.path, f"in dissipation, {error}") from None

    @property
    def bounds(self) -> Bounds | None:
        """The bounds of noise, disturbances and the like in the file; None without any. Raises: `MissingPart`."""
        try:
            return bounds(self.module.bounds) if self.has("bounds") else None
        except NoBounds as error:
            raise MissingPart(self.path, str(error)) from None

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the user on expressions that SymPy rewrites so that they differ from the text on the declared box.
        Raises: `MissingPart`."""
        around = box(self.plant.signals, self.plant.nominal) if self.folds else {}
        return tuple(str(note) for note in (fold.on(around) for fold in self.folds) if note)

    def has(self, part: str) -> bool:
        """Return whether the file defines `part`, such as "trial"; for "step" a tuning with a period suffices."""
        return hasattr(self.module, part) or (part == "step" and bool(self._first))

    @property
    def tuning(self) -> Tuning:
        """The observers that the file defines, by name; empty where it defines no `tuning`. Raises: `MissingPart`."""
        default = "" if self.default in self.tables else self.default  # a user's table is not the table `observer`
        return Tuning(self.path, self.plant, self._tables, default, self.setting, lambda name: name not in self.tables)

    @property
    def _tables(self) -> Mapping[str, Any]:
        tables = getattr(self.module, "tuning", {})
        if not isinstance(tables, Mapping):
            reason = f"tuning is of type {type(tables).__name__}; make it a mapping from observers to their arguments"
            raise MissingPart(self.path, reason)
        return {**tables, **self.tables}

    def step(
        self,
        observer: str | None = None,
        dt: float | None = None,
        start: Start | None = None,
        period: Callable[[], float] | None = None,
    ) -> CallableStep:
        """Return the step of a tuning, or of an observer, by name, at its own period or at `dt` (s); by default the
        result of its `step()`, else the step of the first tuning that has a period. `start` as in `Tuning.observer`,
        for a tuning by name; `period` returns the period of a tuning that has none, by default the period of the
        model's own step, which is then built.

        Raises: `MissingPart`, `ModelFails`, `BadModelFile`, `Refuted`.
        """
        if observer is None and not self.take and (hasattr(self.module, "step") or not self.has("step")):
            return self.setting.on(self._written_step())
        name = self._first if observer is None else observer
        tuning = self.tuned(name, dt)
        default_period = period or (lambda: self._default_period)
        return _guarded(self.path, lambda: tuning.step(name, default_period, dt, start))

    def tuned(self, name: str, dt: float | None = None) -> Tuning:
        """Return the model's tunings, with one for the observer `name` added if it has none. A textbook name gets the
        tuning of the observer that it stands for; another name gets starting gains, at the period `dt`, else at the
        period in the setting, else at the period of the model's own step. Raises: `MissingPart` for an unknown
        observer, or one that no form of the plant admits."""
        tuning = self.tuning.with_textbook_name(name)
        if name in tuning.tables:
            return tuning
        if name not in (*observers.__all__, *SYNONYMS):
            raise MissingPart(self.path, self._untuned(name))
        period = dt or self.period
        rows = [of(self.setting.form, self.plant)] if self.setting.form else everywhere(self.plant)
        one = first(name, rows, period and longest(period))
        if isinstance(one, NoFirst):
            raise MissingPart(self.path, self._unstarted(name, one)) from one.too_long
        table = one.table()
        if isinstance(period, tuple):
            table = per_sample(getattr(observers, name), table, period[1]) | {"dt": list(period)}
        return replace(tuning, tables={**tuning.tables, name: table})

    @property
    def period(self) -> float | tuple[float, float] | None:
        """The sampling period, or the shortest and the longest one: of the setting, else of the model's own step; None
        without either. Raises: as `step` does."""
        if self.setting.dt is not None or not self.has("step"):
            return self.setting.dt
        return self.limits or self._default_period

    @property
    def limits(self) -> tuple[float, float] | None:
        """The shortest and the longest dt of the model's own step, None if it has one dt, or a setting has. Raises: as
        `step` does."""
        if self.setting.dt is not None or not self.has("step"):
            return None
        dt = self._written_step().limits if hasattr(self.module, "step") else self._tables[self._first].get("dt")
        return (float(dt[0]), float(dt[1])) if isinstance(dt, list | tuple) else None

    @property
    def _first(self) -> str:
        timed = (name for name, table in self._tables.items() if isinstance(table, Mapping) and "dt" in table)
        return self.take or self.default or next(timed, "")

    @cached_property
    def _default_period(self) -> float:
        if hasattr(self.module, "step"):
            return self._written_step().dt
        return self.tuning.period(self._first or next(iter(self.tuning.tables)))

    def _unstarted(self, name: str, why: NoFirst) -> str:
        if why.ruled:
            return f"{self._untuned(name)}; it has no starting gains: {why.reason}"
        if why.too_long:
            return f"{name} with starting gains: {why.reason}"
        in_form = f" in the form {self.setting.form}" if self.setting.form else ""
        return f"{name} does not take this plant{in_form}: {why.reason}; `hgogen check {self.path}` names what does"

    def _untuned(self, name: str) -> str:
        tunings = ", ".join(self.tuning.tables)
        known = f"it has tunings for {tunings}" if tunings else "it has no tuning"
        if name not in (*observers.__all__, *SYNONYMS):
            listed = f"the observers are {', '.join(observers.__all__)}"
            fix = nearest(name, [*self.tuning.tables, *SYNONYMS, *observers.__all__], listed)
            return f"there is no observer {name!r:.60}, {known}; {fix}"
        every, needed = arguments(getattr(observers, name))
        fix = self.fixes["tuning"].format(observer=name, arguments=", ".join(needed))
        besides = ", ".join(key for key in every if key not in needed)
        return f"{known}, none for {name}; add {fix} (it also takes {besides})"

    def _written_step(self) -> CallableStep:
        step = self._called("step", CallableStep)
        if not isinstance(step, CallableStep):
            raise MissingPart(self.path, f"step() returns the type {type(step).__name__}; return hg.sample(...)")
        if step is not self._part("step"):
            return step
        fresh: CallableStep = copy(step)
        fresh.reset()  # the file may have called it
        return fresh

    def trials(self) -> tuple[Trial, ...]:
        """Return the result of the file's `trial()`, one trial or several. Raises: `MissingPart`, `ModelFails`."""
        returned = self._called("trial", Trial | tuple | list)
        trials = (returned,) if isinstance(returned, Trial) else returned
        if not isinstance(trials, tuple | list) or not trials or not all(isinstance(t, Trial) for t in trials):
            kind = type(returned).__name__
            raise MissingPart(self.path, f"trial() returns the type {kind}; return a Trial or a tuple of them")
        names = [trial.name for trial in trials]
        if len(set(map(files.name_key, names))) < len(names):
            raise MissingPart(self.path, f"trial() returns two trials of one name, {', '.join(names)}; rename one")
        return tuple(trials)

    def _part(self, part: str) -> Any:
        if not self.has(part):
            raise MissingPart(self.path, f"defines no {part}, which this command needs; add {self.fixes[part]}")
        return getattr(self.module, part)

    def _called(self, part: str, wanted: Any) -> Any:
        function = self._part(part)
        if isinstance(function, wanted):
            return function
        if not callable(function):
            kind = type(function).__name__
            raise MissingPart(self.path, f"{part} is of type {kind}; make it a function, {self.fixes[part]}")
        return _guarded(self.path, function)


def load(path: str | Path) -> Model:
    """Return the model at a path. A bare name is searched for in the folder `models`, then among the models that come
    with hgogen.

    The file's prints go to the standard error stream. A file that ends the process by os._exit does end it.

    Raises: `NoModel`; `ModelFails` with file, line and error where Python cannot import it; `BadModelFile` for a name
    that cannot be part of a path, and with file, key and fix for plain text.
    """
    file = located(str(path))
    try:
        files.demand_file_name(file.stem)
    except files.BadFileName as error:
        raise BadModelFile(str(file), "", f"{error} in the name of the file") from None
    return _LOADERS[file.suffix](file)


def _plain(path: Path) -> Model:
    declared = read(path)
    contents = {name: getattr(declared, name) for name in ("plant", "known", "reference")}
    contents |= {name: value for name in ("dissipation", "bounds") if (value := getattr(declared, name))}
    parts, default = SimpleNamespace(__doc__=declared.meaning, __name__=path.stem, **contents), ""
    if declared.observer:
        kind = declared.observer.get("kind")  # the table has the name of its observer, if that is free
        default = kind if isinstance(kind, str) and kind not in declared.tuning else "observer"
    if declared.observer or declared.tuning:
        parts.tuning = {default: declared.observer} | dict(declared.tuning) if default else dict(declared.tuning)
    if declared.trial:
        parts.trial = lambda: trial_of(declared)
    return Model(path.stem, str(path), parts, _PLAIN, default, declared.folds)


def _python(path: Path) -> Model:
    try:
        code = compile(content_of(path, BYTES), str(path), "exec", dont_inherit=True)
    except Unread as error:
        raise NoModel(str(path), error.reason, listed()) from None
    except SyntaxError as error:
        raise ModelFails(str(path), error.lineno or 1, f"{error.msg}; correct the syntax") from None
    except ValueError as error:  # a null byte, or a byte that is not in the file's encoding
        raise ModelFails(str(path), 1, f"is no Python text ({error})") from None
    module = ModuleType(f"hgogen_model_{sha256(fsencode(path.resolve())).hexdigest()[:12]}_{path.stem}")
    module.__file__ = str(path)
    sys.modules[module.__name__] = module
    linecache.checkcache(str(path))
    _guarded(str(path), lambda: exec(code, module.__dict__))
    return Model(path.stem, str(path), module, _PYTHON)


_LOADERS: dict[str, Callable[[Path], Model]] = {PYTHON: _python, **dict.fromkeys(READERS, _plain)}  # by suffix


def _guarded(path: str, function: Callable[[], Returned]) -> Returned:
    """Return the value of `function`, code of the model file. Any error that it raises becomes a `ModelFails`, or the
    error itself where that is hgogen's, with file and line."""
    try:
        with redirect_stdout(sys.stderr):
            return function()
    except BadModelFile:
        raise
    except Refuted as error:
        raise replace(error, where=error.where or path) from None
    except KeyboardInterrupt:  # most likely the user's
        raise
    except BaseException as error:
        frames = [f.lineno for f in traceback.extract_tb(error.__traceback__) if f.filename == path]
        reason = sentence(error) if isinstance(error, Exception) else ends_python(error)
        raise ModelFails(path, frames[-1] or 1 if frames else 1, reason) from error
