"""What every command of the command line has: the app, errors as one sentence and an exit status, a progress bar."""

import json
import traceback
import warnings
from collections.abc import Callable, Iterable, Mapping
from contextvars import ContextVar
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import wraps
from inspect import Parameter, Signature, getdoc, signature
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
from typer.core import TyperCommand

from hgogen.calling import native
from hgogen.commands.keys import names
from hgogen.commands.process import (
    INTERRUPTED,
    console,
    dropped,
    interrupted,
    interruptible,
    listen,
    note,
    printing,
    results,
)
from hgogen.errors import HgogenError
from hgogen.modelfiles.raised import ends_python
from hgogen.modelfiles.setting import SEEDS, Setting
from hgogen.recheck.text import RecheckError
from hgogen.sentence import Encoded, encoded
from hgogen.target import demand, remove, write

if TYPE_CHECKING:  # what takes a second to import, and `hgogen list` and `recheck` do not need
    from hgogen.calling.samples import Engine
    from hgogen.model import Model
    from hgogen.trial import Trial


class Precision(StrEnum):
    """Working precision of a step."""

    FLOAT = "float"
    DOUBLE = "double"


class Guarding(StrEnum):
    """What guards of a step there are."""

    ALL = "all"
    NONE = "none"


class Preference(StrEnum):
    """What a step is made for."""

    SPEED = "speed"
    FLASH = "flash"


class Reader(StrEnum):
    """Who runs the step."""

    C = "c"
    PYTHON = "python"


ModelArgument = Annotated[
    str, typer.Argument(metavar="MODEL", help="A model file, or the name of one that `hgogen list` shows.")
]
Tuned = Annotated[
    str | None,
    typer.Option("--observer", metavar="NAME", help="A tuning of the model, or an observer."),
]
Seeds = Annotated[int | None, typer.Option(min=1, max=SEEDS, help="Number of noise seeds; by default the trial's.")]
Out = Annotated[Path | None, typer.Option("--out", "-o", help="Folder of the results; by default build/MODEL.")]
ReaderOption = Annotated[Reader | None, typer.Option("--engine", help="c or python; C where there is a compiler.")]
OneTrial = Annotated[str | None, typer.Option("--trial", help="The trial of this name; by default all.")]
Jobs = Annotated[
    int | None, typer.Option("--jobs", metavar="N", min=1, help="Processes, by default one for each core.")
]
Json = Annotated[bool, typer.Option("--json", help="Print JSON alone; the keys are listed above.")]


@dataclass(frozen=True)
class Runs:
    """A campaign as a user asks for it; None where nothing is said."""

    vary: str | None = None
    runs: int | None = None
    draw: int | None = None
    jobs: int | None = None
    scheduler: str | None = None
    results: Path | None = None
    repeat: int | None = None

    def __bool__(self) -> bool:
        """Whether anything is said."""
        return any(value is not None for value in vars(self).values())


@dataclass(frozen=True)
class Columns:
    """How the columns of a log are read: which holds times, else the `period` between rows, and which are signals."""

    time: str | None = None
    period: float | None = None
    map_: list[str] | None = None


NO_RUNS = Runs()
NO_COLUMNS = Columns()
_AS_JSON: ContextVar[bool] = ContextVar("as_json", default=False)

_SET = {  # what a user may set of every step that a command makes
    "form": (str, typer.Option("--form", metavar="NAME", help="The form, in the place of the model's.")),
    "method": (str, typer.Option("--method", metavar="NAME", help="The method, in the place of the model's.")),
    "dt": (float, typer.Option("--dt", help="The sampling period, in the model's unit of time.")),
    "real": (
        Precision,
        typer.Option("--real", help="float or double; by default C is written in float and samples run in double."),
    ),
    "guards": (
        Guarding,
        typer.Option("--guards", help="all, or none: the mathematics alone, without clamps, tests and restarts."),
    ),
    "prefer": (
        Preference,
        typer.Option("--prefer", help="speed, or flash: what repeats in loops, a shorter program that takes longer."),
    ),
    "parameters": (
        Path,
        typer.Option("--parameters", metavar="FILE", help="Values of parameters, as `hgogen fit` writes them."),
    ),
    "tuning": (
        Path,
        typer.Option(
            "--tuning", metavar="FILE", help="Tunings, as `hgogen tune` writes them; of these the row to take is."
        ),
    ),
}


_CAMPAIGN = {  # what a user may say of runs that differ
    "vary": (
        str,
        typer.Option(
            "--vary",
            metavar="LIST",
            help="What differs from run to run, in its range, by 10%, by 0.2 or in 0.8..1.2: states by name or x0, "
            "parameters by name or `parameters`, noise, as in x0,a=10%,noise=0.5..2.",
        ),
    ),
    "runs": (int, typer.Option("--runs", metavar="N", help="How many runs, 1000 by default; run k has noise seed k.")),
    "draw": (int, typer.Option("--draw", metavar="SEED", help="Seed of what varies, by default 0.")),
    "jobs": (int, typer.Option("--jobs", metavar="N", min=1, help="Processes, by default one for each core.")),
    "scheduler": (str, typer.Option("--scheduler", metavar="ADDRESS", help="Scheduler of a Dask cluster that runs.")),
    "results": (
        Path,
        typer.Option(
            "--results", metavar="FOLDER", help="Folder of the runs' numbers as they come; runs there are not repeated."
        ),
    ),
    "repeat": (int, typer.Option("--repeat", metavar="K", min=0, help="Run number K of the campaign alone.")),
}
_COLUMNS = {  # what a user may say of the columns of a log
    "time": (str, typer.Option("--time", help="The column of times, in the unit of the model's time.")),
    "period": (
        float,
        typer.Option(
            "--period", help="The time between rows, in the unit of the model's time, where no column has times."
        ),
    ),
    "map_": (
        list[str],
        typer.Option(
            "--map",
            metavar="SIGNAL=COLUMN",
            help="Which column is a signal, or what of columns, such as y='T1 + 273.15' or i='-[I (A)]'; repeat it.",
        ),
    ),
}
_GROUPS = ((Setting, _SET, False), (Runs, _CAMPAIGN, False), (Columns, _COLUMNS, True))  # and whether in its place


def _with_options(
    function: Callable[..., Any],
    options: Mapping[str, tuple[Any, Any]],
    instead: Callable[..., Any],
    place: str = "",
    there: bool = False,
) -> Callable[..., Any]:
    """A function with options behind its own, by name an annotation and a default. `instead` is called in its place:
    with its arguments, and the options by name; they stand for the argument `place`, and stand where it is if
    `there`."""
    known: dict[str, tuple[Any, Any]] = {}
    for name, each in signature(function).parameters.items():
        known |= {name: (each.annotation, each.default)} if name != place else options if there else {}
    known |= options

    @wraps(function)
    def taking(**arguments: Any) -> Any:
        chosen = {name: arguments.pop(name) for name in options}
        return instead(arguments, chosen)

    taking.__annotations__ = {name: annotation for name, (annotation, _) in known.items()}
    taking.__signature__ = Signature(  # type: ignore[attr-defined]
        [
            Parameter(name, Parameter.KEYWORD_ONLY, default=default, annotation=annotation)
            for name, (annotation, default) in known.items()
        ]
    )
    return taking


def _with_group(
    function: Callable[..., Any], group: Any, options: Mapping[str, Any], there: bool
) -> Callable[..., Any]:
    """A command with an option for each part of a group, as a `Setting`, for its argument of that type, if any."""
    parameters = signature(function).parameters
    place = next((name for name, each in parameters.items() if each.annotation is group), None)
    if place is None:
        return function
    known = {name: (Annotated[kind | None, option], None) for name, (kind, option) in options.items()}

    def grouped(arguments: Mapping[str, Any], chosen: Mapping[str, Any]) -> Any:
        return function(**arguments, **{place: group(**chosen)})

    return _with_options(function, known, grouped, place, there)


class Report(Encoded):
    """What a command found, a dataclass: what it prints, as JSON or as tables, and how it ends."""

    def tables(self) -> Iterable[Any]:
        """What is printed unless JSON is asked for."""
        return ()

    def demand(self) -> None:
        """Raise what ends the command after it has printed, with an exit status of its own."""


Written = Annotated[tuple[Path, ...], "paths of the files written"]
Reported = TypeVar("Reported", bound=Report)


def _reporting(function: Callable[..., Report]) -> Callable[..., None]:
    """A command that prints the report of a function."""

    def printing_(arguments: Mapping[str, Any], chosen: Mapping[str, bool]) -> None:
        token = _AS_JSON.set(chosen["as_json"])
        try:
            report = function(**arguments)
            show(chosen["as_json"], report, *(() if chosen["as_json"] else report.tables()))
        finally:
            _AS_JSON.reset(token)
        report.demand()

    return _with_options(function, {"as_json": (Json, False)}, printing_)


def early(*parts: Any) -> None:
    """Print tables before the report, unless JSON is asked for."""
    show(False, {}, *(() if _AS_JSON.get() else parts))


def command(
    *reports: type[Encoded], cls: type[TyperCommand] = TyperCommand
) -> Callable[[Callable[..., Report | None]], Any]:
    """Make a command of a function that gives one of the `reports`, or that prints itself. Errors become one sentence
    and an exit status."""

    def register(function: Callable[..., Any]) -> Any:
        app = typer.Typer(add_completion=False, rich_markup_mode="markdown", pretty_exceptions_enable=False)
        documented = f"{getdoc(function)}\n\n{_keys(function.__name__.rstrip('_'), reports)}"
        if reports and "as_json" not in signature(function).parameters:
            function = _reporting(function)
        for group in _GROUPS:
            function = _with_group(function, *group)

        @app.command(cls=cls, help=documented)
        @wraps(function)
        def command(*args: Any, **kwargs: Any) -> None:
            try:
                listen()
                with interruptible(), printing(), warnings.catch_warnings():
                    warnings.showwarning = _warned
                    function(*args, **kwargs)
                    results().flush()
            except BrokenPipeError:  # as after `| head`
                raise typer.Exit(dropped()) from None
            except (HgogenError, RecheckError) as error:
                note(str(error))
                raise typer.Exit(error.status) from None
            except (OSError, MemoryError, RecursionError) as error:
                note(next((text for kind, text in _FAILURES.items() if isinstance(error, kind)), str(error)))
                raise typer.Exit(2) from None
            except BaseException as error:
                if isinstance(error, Exception):  # typer's own, or a fault of this program
                    raise
                if isinstance(error, KeyboardInterrupt) and interrupted():
                    note("interrupted")
                    raise typer.Exit(INTERRUPTED) from None
                at = traceback.extract_tb(error.__traceback__)[-1]
                note(f"{at.filename}, line {at.lineno}: {ends_python(error)}")
                raise typer.Exit(2) from None

        made = typer.main.get_command(app)
        vars(made)["reports"] = reports
        return made

    return register


_FAILURES = {
    MemoryError: "there is not enough memory; take a shorter trial or record, or fewer seeds",
    RecursionError: "an expression is nested too deep; write it in several",
}


def _keys(name: str, reports: Iterable[type[Encoded]]) -> str:
    """The keys of a command's JSON, as its help names them."""
    listed = "; or ".join(", ".join(names(report)) for report in reports)
    return f"JSON keys: {listed}. `hgogen schema {name}` describes them." if listed else ""


def _warned(message: Warning | str, category: type[Warning], *_: Any, **__: Any) -> None:
    """A warning in one line; what is meant for users says what it is."""
    kind = "" if issubclass(category, UserWarning) else f"{category.__name__}: "
    note(f"{kind}{' '.join(str(message).split())}")


def engine_here(reader: Reader | None = None) -> "Engine":
    """The reader that is asked for, else C where there is a compiler, else Python, and says so."""
    if reader:
        return reader.value
    engine = native.engine()
    if engine == "python":
        note(str(native.NoCompilerWarning.__doc__))
    return engine


def one_or_all(trials: tuple["Trial", ...], name: str | None) -> tuple["Trial", ...]:
    """The trial of that name, by default all of them. Raises: `BadParameter`."""
    chosen = tuple(one for one in trials if name in (None, one.name))
    if not chosen:
        raise typer.BadParameter(f"{name!r} is none of {', '.join(one.name for one in trials)}", param_hint="--trial")
    return chosen


class Bar(Progress):
    """A progress bar on the standard error stream, if that is a terminal; `total`: None where nobody knows it."""

    def __init__(self, what: str, total: int | None) -> None:
        err = Console(stderr=True)
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
        super().__init__(*columns, console=err, transient=True, disable=not err.is_terminal)
        self._only = self.add_task(what, total=total)

    def tick(self, following: str | None = None) -> None:
        """One more is done; what comes next may have a name of its own."""
        self.update(self._only, advance=1, description=following)

    def advance_by(self, done: int) -> None:
        """So many more are done."""
        self.advance(self._only, done)

    def reach(self, done: int) -> None:
        """So many are done."""
        self.update(self._only, completed=done)


def show(as_json: bool, value: Any, *shown: Any) -> None:
    """Print a result: as JSON alone, or as tables."""
    if as_json:
        print(json_text(value), file=results())
        return
    for part in shown:
        console().print(part, crop=False)  # a line of code, or a path, stays whole


def json_text(value: Any, indent: int = 2) -> str:
    """The text of a value in JSON, as `encoded` makes it."""
    return json.dumps(encoded(value), indent=indent, allow_nan=False)


def rendered(drawn: Mapping[str, Any]) -> dict[str, bytes]:
    """The files of figures by name, made with a progress bar."""
    from hgogen.trials import figures as figure

    files: dict[str, bytes] = {}
    with Bar("figures", len(drawn)) as bar:
        for name, one in drawn.items():
            files |= figure.files(name, one)
            bar.tick()
    return files


@dataclass(frozen=True)
class Folder:
    """Where a command's results go: the folder that the user named, by default `build`, and the one `below` it."""

    root: Path
    below: str = ""

    def demand(self, *names: str) -> list[Path]:
        """The paths of files of these names. Raises: `CannotWrite` where they cannot be written."""
        return demand(map(self._within, names), self.root)

    def write(self, files: Mapping[str, str | bytes]) -> list[Path]:
        """Write all files by name, or none; returns their paths. Raises: `CannotWrite`."""
        return write({self._within(name): content for name, content in files.items()}, self.root)

    def remove(self, name: str) -> None:
        """Remove a file, if it is there. Raises: `CannotWrite`."""
        remove(self._within(name), self.root)

    def save(
        self,
        report: Reported,
        name: str,
        files: Mapping[str, str | bytes] = MappingProxyType({}),
        more: Iterable[Path] = (),
    ) -> Reported:
        """Write files, and the report as JSON by that name, with the paths of all and of `more` in its `files`; returns
        it. Raises: `CannotWrite`.
        """
        paths = (*self.demand(*files, name), *more)
        complete: Reported = replace(report, files=paths)  # type: ignore[type-var]
        self.write({**files, name: json_text(complete) + "\n"})
        return complete

    def _within(self, name: str) -> str:
        return f"{self.below}/{name}" if self.below else name


def folder_of(out: Path | None, model: "Model", observer: str | None = None) -> Folder:
    """The folder --out, by default build/MODEL, or build/MODEL_OBSERVER of a tuning that is asked for."""
    return Folder(Path("build"), named(model, observer)) if out is None else Folder(out)


def named(model: "Model", observer: str | None) -> str:
    """The name of the folder of results: that of the model, and of the tuning where one is asked for."""
    return f"{model.name}_{observer}" if observer else model.name
