"""What every command of the command line has: the app, errors as one sentence and an exit status, a progress bar."""

import json
import os
import sys
from collections.abc import Callable, Mapping
from enum import StrEnum
from functools import wraps
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
from typer.core import TyperCommand

from hgogen.call import Engine
from hgogen.check import Refuted
from hgogen.commands import tables
from hgogen.commands.agreement import Disagree
from hgogen.emit import native
from hgogen.errors import HgogenError
from hgogen.recheck.recheck import NothingVerified, NotVerified
from hgogen.trial import Trial

# what exits with 1; other errors with 2
FAILURES = (Refuted, Disagree, NotVerified, NothingVerified, native.CompilerFailed)
UNREAD = 141  # the exit status where the reader of the output is gone, as the shell gives it: 128 + SIGPIPE


class Reader(StrEnum):
    """Who runs the step."""

    C = "c"
    PYTHON = "python"


app = typer.Typer(
    help="From a nonlinear model to an observer: readable C for firmware and a running Python step.",
    epilog="Exit status: 0 done, 1 a refuted hypothesis nobody accepted, a failed comparison or a certificate that is "
    "not verified, 2 usage or bad input.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


ModelArgument = Annotated[str, typer.Argument(metavar="MODEL", help="A model file, or the name of one in models/.")]
Tuned = Annotated[
    str | None, typer.Option("--observer", metavar="NAME", help="A tuning of the model; by default its own step.")
]
Seeds = Annotated[int | None, typer.Option(min=1, help="Number of noise seeds; by default the trial's.")]
Out = Annotated[Path | None, typer.Option("--out", "-o", help="Folder of the results; by default build/MODEL.")]
ReaderOption = Annotated[Reader | None, typer.Option("--engine", help="c or python; C where there is a compiler.")]
OneTrial = Annotated[str | None, typer.Option("--trial", help="The trial of this name; by default all.")]
Json = Annotated[bool, typer.Option("--json", help="Print JSON alone; the keys are listed above.")]


def command(
    name: str | None = None, cls: type[TyperCommand] | None = None
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Register a command whose errors are one sentence and an exit status."""

    def register(function: Callable[..., None]) -> Callable[..., None]:
        @app.command(name, cls=cls)
        @wraps(function)
        def command(*args: Any, **kwargs: Any) -> None:
            try:
                function(*args, **kwargs)
                sys.stdout.flush()
            except BrokenPipeError:  # as after `| head`
                os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
                raise typer.Exit(UNREAD) from None
            except FAILURES as error:
                note(str(error))
                raise typer.Exit(1) from None
            except (HgogenError, OSError) as error:
                note(str(error))
                raise typer.Exit(2) from None

        return function

    return register


def note(sentence: str) -> None:
    """Say something on the standard error stream."""
    print(f"hgogen: {sentence}", file=sys.stderr)


def engine_here() -> Engine:
    """C where there is a compiler, else Python, and says so."""
    if native.compiler():
        return "c"
    note(str(native.NoCompilerWarning.__doc__))
    return "python"


def one_or_all(trials: tuple[Trial, ...], name: str | None) -> tuple[Trial, ...]:
    """The trial of that name, by default all of them. Raises: `BadParameter`."""
    chosen = tuple(one for one in trials if name in (None, one.name))
    if not chosen:
        raise typer.BadParameter(f"{name!r} is none of {', '.join(one.name for one in trials)}", param_hint="--trial")
    return chosen


class Bar(Progress):
    """A progress bar on the standard error stream, if that is a terminal."""

    def __init__(self, what: str, total: int) -> None:
        err = Console(stderr=True)
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
        super().__init__(*columns, console=err, transient=True, disable=not err.is_terminal)
        self._only = self.add_task(what, total=total)

    def tick(self) -> None:
        """One more is done."""
        self.advance(self._only)


def show(as_json: bool, value: dict[str, Any], *shown: Any) -> None:
    """Print a result: as JSON alone, or as tables."""
    if as_json:
        print(json.dumps(value, indent=2, allow_nan=False))
        return
    for part in shown:
        tables.console().print(part)


def save_figures(drawn: Mapping[str, Any], folder: Path) -> list[Path]:
    """Write figures by name into a folder, with a progress bar; returns the files."""
    from hgogen.commands import figure  # here, because matplotlib is slow to import

    paths: list[Path] = []
    with Bar("figures", len(drawn)) as bar:
        for name, one in drawn.items():
            paths += figure.save({name: one}, folder)
            bar.tick()
    return paths
