"""What every command of the command line has: the app, errors as one sentence and an exit status, a report."""

import traceback
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import wraps
from inspect import Parameter, Signature, getdoc, signature
from typing import Annotated, Any, get_type_hints

import typer
from typer.core import TyperCommand

from hgogen.commands.keys import names
from hgogen.commands.options import GROUPS, Json
from hgogen.commands.output import file_list, show
from hgogen.commands.process import INTERRUPTED, dropped, interrupted, interruptible, listen, note, printing, results
from hgogen.errors import HgogenError
from hgogen.modelfiles.raised import ends_python
from hgogen.recheck.text import RecheckError
from hgogen.sentence import Encoded

_AS_JSON: ContextVar[bool] = ContextVar("as_json", default=False)


class Report(Encoded):
    """What a command found, a dataclass: what it prints, as JSON or as tables, with its `files`, and how it ends."""

    def tables(self) -> Iterable[Any]:
        """Return the tables that are printed in the place of JSON."""
        return ()

    def demand(self) -> None:
        """Raise what ends the command after it has printed, with an exit status of its own."""


@dataclass(frozen=True, eq=False)
class ModelReport(Report):
    """What a command found of a model."""

    model: Annotated[str, "path of the model"]


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
        if name != place:
            known[name] = each.annotation, each.default
        elif there:
            known |= options
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


def _with_group(function: Callable[..., Any], group: Any, options: type, there: bool) -> Callable[..., Any]:
    """A command with an option for each part of a group, as a `Setting`, for its argument of that type, if any."""
    parameters = signature(function).parameters
    place = next((name for name, each in parameters.items() if each.annotation is group), None)
    if place is None:
        return function
    known = {name: (each, None) for name, each in get_type_hints(options, include_extras=True).items()}

    def grouped(arguments: Mapping[str, Any], chosen: Mapping[str, Any]) -> Any:
        return function(**arguments, **{place: group(**chosen)})

    return _with_options(function, known, grouped, place, there)


def _reporting(function: Callable[..., Report]) -> Callable[..., None]:
    """A command that prints the report of a function."""

    def printed(arguments: Mapping[str, Any], chosen: Mapping[str, bool]) -> None:
        token = _AS_JSON.set(chosen["as_json"])
        try:
            report = function(**arguments)
            written = getattr(report, "files", ())
            listed = (file_list(written),) if written else ()
            show(chosen["as_json"], report, *(() if chosen["as_json"] else (*report.tables(), *listed)))
        finally:
            _AS_JSON.reset(token)
        report.demand()

    return _with_options(function, {"as_json": (Json, False)}, printed)


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
        for group in GROUPS:
            function = _with_group(function, *group)

        @app.command(cls=cls, help=documented)
        @wraps(function)
        def command(**arguments: Any) -> None:
            with _ending():
                function(**arguments)
                results().flush()

        made = typer.main.get_command(app)
        vars(made)["reports"] = reports
        return made

    return register


@contextmanager
def _ending() -> Iterator[None]:
    """Within it an error is one sentence and an exit status."""
    try:
        listen()
        with interruptible(), printing(), warnings.catch_warnings():
            warnings.showwarning = _warned
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
        if isinstance(error, Exception):  # typer's own, or a fault of this program
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


def _keys(name: str, reports: Iterable[type[Encoded]]) -> str:
    """The keys of a command's JSON, as its help names them."""
    listed = "; or ".join(", ".join(names(report)) for report in reports)
    return f"JSON keys: {listed}. `hgogen schema {name}` describes them." if listed else ""


def _warned(message: Warning | str, category: type[Warning], *_: Any, **__: Any) -> None:
    """A warning in one line; what is meant for users says what it is."""
    kind = "" if issubclass(category, UserWarning) else f"{category.__name__}: "
    note(f"{kind}{' '.join(str(message).split())}")
