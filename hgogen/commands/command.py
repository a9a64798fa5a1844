"""The common parts of all commands: options, errors as one sentence and an exit status, and reports, whose JSON keys
are read from their classes (`hgogen.sentence.Encoded`).
"""

import traceback
import types
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, is_dataclass, replace
from functools import partial, wraps
from inspect import Parameter, Signature, getdoc, signature
from pathlib import Path
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    Literal,
    NamedTuple,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

import typer
from typer.core import TyperCommand

from hgogen.commands.output import (
    INTERRUPTED,
    Folder,
    dropped,
    file_list,
    interrupted,
    interruptible,
    json_text,
    listen,
    note,
    print_result,
    printing,
    results,
)
from hgogen.errors import HgogenError, ReportedWarning
from hgogen.modelfiles.place import ends_python
from hgogen.modelfiles.setting import SEEDS, Option, Setting
from hgogen.recheck.text import RecheckError
from hgogen.run import native
from hgogen.sentence import Encoded, keys_of
from hgogen.target import write

if TYPE_CHECKING:  # slow to import, and not needed by `hgogen list` and `recheck`
    from hgogen.reading.measured import Record
    from hgogen.run.samples import Engine
    from hgogen.trial import Trial


_AS_JSON: ContextVar[bool] = ContextVar("as_json", default=False)


class Report(Encoded):
    """The report of a command, a dataclass: its fields in JSON, its tables, its `files`, and its exit status."""

    def tables(self) -> Iterable[Any]:
        """Return the tables that are printed without --json."""
        return ()

    def demand(self) -> None:
        """Raise the error that sets the exit status, after the report was printed, if there is one."""


@dataclass(frozen=True, eq=False)
class ModelReport(Report):
    """The report of a command about a model."""

    model: Annotated[str, "path of the model"]


def _options_of(
    function: Callable[..., Any], reporting: bool
) -> tuple[dict[str, tuple[Any, Any]], dict[str, tuple[Any, tuple[str, ...]]]]:
    options: dict[str, tuple[Any, Any]] = {}
    behind: dict[str, tuple[Any, Any]] = {}
    groups: dict[str, tuple[Any, tuple[str, ...]]] = {}
    for name, each in signature(function).parameters.items():
        if each.annotation in GROUPS:
            hints = get_type_hints(each.annotation, include_extras=True)
            groups[name] = each.annotation, tuple(hints)
            (options if GROUPS[each.annotation] else behind).update(
                {part: (_option(hint), None) for part, hint in hints.items()}
            )
        else:
            options[name] = each.annotation, each.default
    return options | ({"as_json": (Json, False)} if reporting else {}) | behind, groups


def _option(hint: Any) -> Any:
    """Return the annotation of an option for typer; of a union, the first type."""
    kind, option = get_args(hint)
    if not isinstance(option, Option):
        return hint
    return Annotated[_alternatives(kind)[0] | None, typer.Option(help=option.help, metavar=option.metavar)]


PRINTED = "-"  # the standard output as the file of --json


def json_file(as_json: str | bool | None) -> Path | None:
    """Return the file that --json names; None for the standard output, or without --json."""
    return Path(as_json) if isinstance(as_json, str) and as_json != PRINTED else None


def print_report(report: Report, as_json: str | bool | None) -> None:
    """Print a report as tables (each as soon as it is computed) or as JSON, to the standard output or into a file.
    Raises: the errors of `Report.demand`."""
    file = json_file(as_json)
    if file is not None:
        new = "" if file.parent.is_dir() else ", in a new folder"
        write({file.name: json_text(report, indent=1) + "\n"}, file.parent)
        note(f"wrote {file}{new}")
    elif as_json:
        print_result(True, report)
    else:
        for part in report.tables():
            print_result(False, None, part)
        if written := getattr(report, "files", ()):
            print_result(False, None, file_list(written))
    report.demand()


def early(*parts: Any) -> None:
    """Print tables as soon as they are computed, in advance of the report, unless --json is given."""
    print_result(False, {}, *(() if _AS_JSON.get() else parts))


def command(
    *reports: type[Encoded], cls: type[TyperCommand] = TyperCommand
) -> Callable[[Callable[..., Report | None]], Any]:
    """Return a decorator that turns a function into a command. The function returns one of the `reports`, or prints by
    itself; its errors become one sentence and an exit status."""

    def register(function: Callable[..., Any]) -> Any:
        app = typer.Typer(add_completion=False, rich_markup_mode="markdown", pretty_exceptions_enable=False)
        reporting = bool(reports) and "as_json" not in signature(function).parameters
        options, groups = _options_of(function, reporting)

        @wraps(function)
        def command(**arguments: Any) -> None:
            with _ending():
                groups_by_name = {
                    name: kind(**{part: arguments.pop(part) for part in parts})
                    for name, (kind, parts) in groups.items()
                }
                if reporting:
                    token = _AS_JSON.set(arguments.pop("as_json"))
                    try:
                        print_report(function(**arguments, **groups_by_name), _AS_JSON.get())
                    finally:
                        _AS_JSON.reset(token)
                else:
                    function(**arguments, **groups_by_name)
                results().flush()

        command.__annotations__ = {name: annotation for name, (annotation, _) in options.items()}
        command.__signature__ = Signature(  # type: ignore[attr-defined]
            [
                Parameter(name, Parameter.KEYWORD_ONLY, default=default, annotation=annotation)
                for name, (annotation, default) in options.items()
            ]
        )
        name, keys = function.__name__.rstrip("_"), "; or ".join(", ".join(names(report)) for report in reports)
        described = f"JSON keys: {keys}. `hgogen schema {name}` describes them." if reports else ""
        app.command(cls=cls, help=f"{getdoc(function)}\n\n{described}")(command)
        typer_command = typer.main.get_command(app)
        vars(typer_command)["reports"] = reports
        return typer_command

    return register


@contextmanager
def _ending() -> Iterator[None]:
    """Run a command as the body of this context; errors become one sentence and an exit status."""
    try:
        listen()
        with interruptible(), printing(), warnings.catch_warnings():
            warnings.showwarning = partial(_warned, set())
            warnings.simplefilter("ignore", ReportedWarning)
            yield
    except BrokenPipeError:  # as after `| head`
        raise typer.Exit(dropped()) from None
    except (HgogenError, RecheckError) as error:
        note(str(error))
        raise typer.Exit(error.status) from None
    except (OSError, MemoryError, RecursionError) as error:
        note(next((text for kind, text in _FAILURES.items() if isinstance(error, kind)), str(error)))
        raise typer.Exit(2) from None
    except BaseException as error:
        if isinstance(error, Exception):  # typer's own error, or a bug of hgogen
            raise
        if isinstance(error, KeyboardInterrupt) and interrupted():
            note("interrupted")
            raise typer.Exit(INTERRUPTED) from None
        at = traceback.extract_tb(error.__traceback__)[-1]
        note(f"{at.filename}, line {at.lineno}: {ends_python(error)}")
        raise typer.Exit(2) from None


_FAILURES = {
    MemoryError: "there is not enough memory; take a shorter trial or record, or fewer seeds",
    RecursionError: "an expression is nested too deep; write it in several",
}


def _warned(printed: set[str], message: Warning | str, category: type[Warning], *_: Any, **__: Any) -> None:
    """Print a warning unless its text is in `printed`, which happens if a command builds the same step several
    times."""
    kind = "" if issubclass(category, UserWarning) else f"{category.__name__}: "
    text = f"{kind}{' '.join(str(message).split())}"
    if text not in printed:
        note(text)
    printed.add(text)


def explained(context: typer.Context, names: str | None) -> str | None:
    """Return the names of observers in an option unchanged, after printing a note on each textbook name."""
    if names and not context.resilient_parsing:
        from hgogen.estimators.synonyms import SYNONYMS  # slow to import

        note(*(SYNONYMS[name].sentence for name in names.split(",") if name in SYNONYMS))
    return names


Value = TypeVar("Value")
Reader = Literal["c", "python"]
ModelArgument = Annotated[str, typer.Argument(metavar="MODEL", help="A model file, or a name from `hgogen list`.")]
Tuned = Annotated[
    str | None,
    typer.Option(
        "--observer", metavar="NAME", help="A tuning of the model, or the name of an observer.", callback=explained
    ),
]
Seeds = Annotated[
    int | None,
    typer.Option(min=1, max=SEEDS, help="Number of noise seeds; by default the number that the trial declares."),
]
Out = Annotated[Path | None, typer.Option("--out", "-o", help="Folder of the results; by default build/MODEL.")]
ReaderOption = Annotated[
    Reader | None, typer.Option("--engine", help="c or python; by default C if there is a compiler.")
]
OneTrial = Annotated[str | None, typer.Option("--trial", help="The name of the trial; by default all trials.")]
Jobs = Annotated[
    int | None, typer.Option("--jobs", metavar="N", min=1, help="Number of processes; by default one for each core.")
]
Json = Annotated[bool, typer.Option("--json", help="Print JSON alone; the keys are listed above.")]
Data = Annotated[
    list[Path], typer.Option("--data", help="A log: CSV, Parquet, MAT, Excel, ULog or MDF. May be repeated.")
]
Truth = Annotated[
    list[str] | None,
    typer.Option("--truth", metavar="STATE=COLUMN", help="A measured hidden state, used only to judge estimates."),
]
Shift = Annotated[
    list[str] | None,
    typer.Option(
        metavar="SIGNAL=SAMPLES",
        help="Move a signal to later samples, by a negative number to earlier ones. May be repeated.",
    ),
]
Deep = Annotated[bool, typer.Option("--deep", help="Also try forms that may take seconds.")]
HeldOut = Annotated[
    list[str] | None,
    typer.Option(
        metavar="PART|FILE",
        help="The last part of each log, used only to judge: by default 0.3, 0 for none. Or the file of another log.",
    ),
]


@dataclass(frozen=True)
class Runs:
    """The command-line options of a campaign; all are None if no campaign is requested."""

    vary: Annotated[
        str | None,
        typer.Option(
            metavar="LIST",
            help="What changes from run to run: states by name or x0, parameters by name or `parameters`, noise. Each "
            "within its range, or by =10%, =0.2 or =0.8..1.2, as in x0,a=10%,noise=0.5..2.",
        ),
    ] = None
    runs: Annotated[
        int | None, typer.Option(metavar="N", help="Number of runs, by default 1000; run k has noise seed k.")
    ] = None
    draw: Annotated[int | None, typer.Option(metavar="SEED", help="Seed of the random variations, by default 0.")] = (
        None
    )
    jobs: Jobs = None
    scheduler: Annotated[str | None, typer.Option(metavar="ADDRESS", help="Scheduler of a Dask cluster.")] = None
    results: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER", help="Folder for the result of each run; runs with a result there are not repeated."
        ),
    ] = None
    repeat: Annotated[int | None, typer.Option(metavar="K", min=0, help="Only run number K of the campaign.")] = None

    def __bool__(self) -> bool:
        return any(value is not None for value in vars(self).values())


@dataclass(frozen=True)
class Columns:
    """The command-line options with which a log is read: the column of times, else the `period` between rows; the time
    of the first row, if `start` sets it; the columns of the signals; the rows to use; the spelling of numbers and
    dates."""

    time: Annotated[
        str | None,
        typer.Option(
            help="The column of times, or an expression of columns such as time/1000: numbers in the model's unit of "
            "time, dates, or times of day."
        ),
    ] = None
    period: Annotated[
        float | None,
        typer.Option(help="The time between rows, in the unit of the model's time, if no column has times."),
    ] = None
    start: Annotated[
        float | None,
        typer.Option(
            help="The time t of the first row of each log. By default the logged time; 0 with dates or --period."
        ),
    ] = None
    map_: Annotated[
        list[str] | None,
        typer.Option(
            "--map",
            metavar="SIGNAL=COLUMN",
            help="The column of a signal, or an expression such as y='T1 + 273.15' or i='-[I (A)]'. May be repeated.",
        ),
    ] = None
    missing: Annotated[
        list[str] | None,
        typer.Option(
            metavar="SIGNAL=WHAT",
            help="Samples to treat as missing: all of one value, y=-999, all that repeat the last one, y=repeats, or "
            "by number, y=150..199. May be repeated.",
        ),
    ] = None
    begin: Annotated[
        str | None,
        typer.Option("--from", metavar="TIME", help="The first time to use, or the first row, such as row:100."),
    ] = None
    end: Annotated[
        str | None,
        typer.Option("--to", metavar="TIME", help="The last time to use, or the last row, such as row:200."),
    ] = None
    every: Annotated[int | None, typer.Option(metavar="N", min=1, help="Use every N-th row.")] = None
    decimal: Annotated[
        Literal[".", ","] | None, typer.Option(help="The decimal sign in a CSV file; by default detected.")
    ] = None
    dates: Annotated[
        Literal["dmy", "mdy", "ymd"] | None,
        typer.Option(help="The order of day, month and year in dates; by default detected."),
    ] = None

    def reading(self) -> dict[str, Any]:
        """Return the arguments of `read` by name, without the columns of signals."""
        from hgogen.reading.cells import Rows  # slow to import

        rows = Rows(self.begin, self.end, self.every or 1)
        return {
            "time": self.time,
            "period": self.period,
            "rows": rows,
            "decimal": self.decimal,
            "dates": self.dates,
        }

    def begun(self, record: "Record") -> "Record":
        """Return the log with the time of its first row set to `start`, if that is given."""
        return record if self.start is None else replace(record, t=self.start + (record.t - record.t[0]))


NO_RUNS = Runs()
NO_COLUMNS = Columns()


GROUPS = {Setting: False, Runs: False, Columns: True}  # whether its options replace a group in the order of options


def engine_here(reader: Reader | None = None) -> "Engine":
    """Return the requested engine, else C if there is a compiler, else Python, with a note."""
    if reader:
        return reader
    engine = native.engine()
    if engine == "python":
        note(str(native.NoCompilerWarning.__doc__))
    return engine


def begun_work(folder: Folder, name: str, what: str) -> Path:
    """Return the path of the file with the unfinished work `what` (words for the message). Raises: `BadParameter` if
    there is no such file."""
    (path,) = folder.demand(name)
    if not path.exists():
        raise typer.BadParameter(f"there is no {what} to go on with, {path}; leave it out", param_hint="--resume")
    return path


def one_or_all(trials: tuple["Trial", ...], name: str | None) -> tuple["Trial", ...]:
    """Return the trial with this name, or all trials without a name. Raises: `BadParameter`."""
    chosen = tuple(one for one in trials if name in (None, one.name))
    if not chosen:
        raise typer.BadParameter(f"{name!r} is none of {', '.join(one.name for one in trials)}", param_hint="--trial")
    return chosen


def numbers_by_name(texts: Iterable[str], option: str) -> dict[str, float]:
    """Return the numbers in texts such as "x=1,v=0". Raises: `typer.BadParameter`."""
    numbers = []
    for part in (part for text in texts for part in text.split(",")):
        name, _, number = part.partition("=")
        try:
            numbers.append((name.strip(), float(number)))
        except ValueError:
            raise typer.BadParameter(f"{part!r} must read NAME=NUMBER", param_hint=option) from None
    return once(numbers, option)


def once(pairs: Iterable[tuple[str, Value]], option: str) -> dict[str, Value]:
    """Return pairs (name, value) as a mapping; `option`: the option in the message. Raises: `typer.BadParameter` for a
    name that occurs twice."""
    values: dict[str, Value] = {}
    for name, value in pairs:
        if name in values:
            raise typer.BadParameter(f"{name} is given twice; leave one of them out", param_hint=option)
        values[name] = value
    return values


def numbers_in(text: str, what: str, option: str) -> tuple[float, ...]:
    """Return the numbers in a text such as "0.5,1"; `what` describes them in the error. Raises:
    `typer.BadParameter`."""
    try:
        return tuple(map(float, text.split(",")))
    except ValueError:
        raise typer.BadParameter(f"{text!r} must be {what}", param_hint=option) from None


def names_in(text: str | None, option: str) -> tuple[str, ...]:
    """Return the names in a text such as "a,b", none for None. Raises: `typer.BadParameter` for a text without a
    name."""
    names = tuple(part.strip() for part in (text or "").split(",") if part.strip())
    if text is not None and not names:
        raise typer.BadParameter(f"{text!r} holds no name; give some, or leave the option out", param_hint=option)
    return names


def horizons(text: str, option: str) -> tuple[int, ...]:
    """Return prediction horizons, in samples, from a text such as "1,5,25". Raises: `typer.BadParameter`."""
    try:
        ahead = tuple(int(part) for part in text.split(","))
    except ValueError:
        ahead = (0,)
    if min(ahead) < 1:
        raise typer.BadParameter(f"{text!r} must be positive whole numbers, such as 1,5,25", param_hint=option)
    return ahead


_WORDS = {bool: "true or false", int: "whole number", float: "number", type(None): "null", Any: "anything"}


class Meaning(NamedTuple):
    """A JSON key at its `depth` in a report (0 for the top level): the type of its value (`kind`), and its meaning."""

    name: str
    depth: int
    kind: str
    text: str
    optional: bool


def names(result: type) -> list[str]:
    """Return the JSON keys of a report."""
    listed = list[str]()
    for key in keys_of(result):
        inner = None if key.name else _result_in(_type_and_meaning(result, key.path)[0])
        listed += names(inner) if inner else [key.name]
    return listed


def meanings(result: type, depth: int = 0, above: tuple[type, ...] = ()) -> Iterator[Meaning]:
    """Yield the JSON keys of a report class with their meanings, each followed by the keys of its nested reports. A
    report within itself is not repeated."""
    for key in keys_of(result):
        annotation, text = _type_and_meaning(result, key.path)
        inner = _result_in(annotation)
        if key.name:
            yield Meaning(key.name, depth, _words(annotation), text, key.optional)
        if inner is None or inner in (*above, result):
            continue
        spread = not key.name and type(None) in _alternatives(annotation)
        for one in meanings(inner, depth + bool(key.name), (*above, result)):
            yield one._replace(optional=one.optional or (spread and one.depth == depth))


def _type_and_meaning(result: Any, path: str) -> tuple[Any, str]:
    """Return the type at the end of a path of attributes such as `result.noise` of a report class, and the description
    of the last field or property."""
    annotation, text, none = result, "", False
    for name in path.split("."):
        none = none or type(None) in _alternatives(annotation)
        owner = next((one for one in _alternatives(annotation) if one is not type(None)), annotation)
        if name.isdigit():
            annotation = get_args(owner)[int(name)]
            continue
        hints = get_type_hints(owner, include_extras=True)
        if name in hints:
            annotation, text = hints[name], ""
        else:
            member = getattr(owner, name)
            getter = getattr(member, "fget", None) or getattr(member, "func", member)  # of a property, cached or not
            annotation = get_type_hints(getter, include_extras=True)["return"]
            text = " ".join((getdoc(getter) or "").split("\n\n")[0].split())
        if get_origin(annotation) is Annotated:
            annotation, text = get_args(annotation)[:2]
    annotation = annotation | None if none else annotation
    return annotation, text[:1].lower() + text[1:].rstrip(".") if text[1:2].islower() or text.startswith("A ") else text


def _alternatives(annotation: Any) -> tuple[Any, ...]:
    return get_args(annotation) if get_origin(annotation) in (Union, types.UnionType) else (annotation,)


def _result_in(annotation: Any) -> type | None:
    if is_dataclass(annotation):
        return annotation if isinstance(annotation, type) and getattr(annotation, "json_keys", "") is not None else None
    return next(filter(None, map(_result_in, get_args(annotation))), None)


def _words(annotation: Any) -> str:
    origin, args = get_origin(annotation), get_args(annotation)
    if origin in (Union, types.UnionType):
        return " or ".join(dict.fromkeys(map(_words, args)))
    if origin is Annotated:
        return _words(args[0])
    if origin is tuple and args[1:] != (...,):
        return f"[{', '.join(map(_words, args))}]"
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return f"{_words(args[1])} by name"
    if isinstance(origin, type) and issubclass(origin, Sequence):
        return f"list of {_words(args[0])}"
    if _result_in(annotation):
        return "object"
    return _WORDS.get(annotation, "text")
