"""The output of a command: a standard output for results alone, tables, a progress bar, the files of a folder, and a
Ctrl-C that is told from a model's own KeyboardInterrupt.
"""

import io
import json
import math
import os
import signal
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, redirect_stdout
from contextvars import ContextVar
from dataclasses import dataclass, replace
from pathlib import Path
from textwrap import wrap
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, TextIO, TypeVar

from rich.console import Console, Group, RenderableType
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
from rich.table import Table
from rich.text import Text

from hgogen.sentence import Encoded, encoded
from hgogen.target import demand, remove, write

if TYPE_CHECKING:  # which takes a second to import
    from hgogen.model import Model


Written = Annotated[tuple[Path, ...], "paths of the files written"]
Reported = TypeVar("Reported", bound=Encoded)
_NARROW = 10  # characters, at which words over a column of numbers begin a new line


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


def headed(title: str, *columns: str, numbers: int = 0, rows: Iterable[Iterable[RenderableType]] = ()) -> Table:
    """A table whose last `numbers` columns are flushed right, and never broken, as the text before them may be."""
    table = Table(
        title=title, box=None, pad_edge=False, padding=(0, 2, 0, 0), min_width=min(len(title), console().width)
    )
    table.title_justify, table.title_style = "left", "bold"
    for name in columns[: len(columns) - numbers]:
        table.add_column(name, overflow="fold")
    for name in columns[len(columns) - numbers :]:
        table.add_column("\n".join(wrap(name, _NARROW)), justify="right", overflow="fold", no_wrap=True)
    for row in rows:
        table.add_row(*row)
    return table


def filled(table: Table) -> list[RenderableType]:
    """A table and a line under it; nothing of one without rows."""
    return [table, ""] if table.row_count else []


def file_list(paths: Iterable[Any]) -> RenderableType:
    """The files written."""
    return Group(Text("files", style="bold"), *(Text(f"  {path}", no_wrap=True, overflow="ignore") for path in paths))


class Bar(Progress):
    """A progress bar on the standard error stream, if that is a terminal; `total`: None where nobody knows it."""

    def __init__(self, what: str, total: int | None) -> None:
        err = Console(stderr=True)
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
        super().__init__(*columns, console=err, transient=True, disable=not err.is_terminal)
        self._only = self.add_task(what, total=total)

    def tick(self, following: str | None = None, done: int = 1) -> None:
        """Count so many more as done; what comes next may have a name of its own."""
        self.update(self._only, advance=done, description=following)

    def reach(self, done: int) -> None:
        """So many are done."""
        self.update(self._only, completed=done)


def rendered(drawn: Mapping[str, Any]) -> dict[str, bytes]:
    """The files of figures by name, made with a progress bar."""
    from hgogen.run import figures as figure

    files: dict[str, bytes] = {}
    with Bar("figures", len(drawn)) as bar:
        for name, one in drawn.items():
            files |= figure.files(name, one)
            bar.tick()
    return files


@dataclass(frozen=True)
class Folder:
    """The place of a command's results: the folder that the user named, by default `build`, and the one `below` it."""

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


def refusals_table(refused: Mapping[str, str], title: str = "without gains") -> list[RenderableType]:
    """Why observers have no gains, or no step, if any."""
    return filled(headed(title, "observer", "why", rows=((name, Text(why)) for name, why in refused.items())))


def cell(value: float | None) -> str:
    """A number; empty where there is none."""
    return "" if value is None or math.isnan(value) else f"{value:.4g}"


WIDTH = 110  # of what is not a terminal, unless COLUMNS says otherwise
INTERRUPTED = 130  # the exit status after Ctrl-C, as a shell gives it: 128 + SIGINT
UNREAD = 141  # where the reader of the output is gone: 128 + SIGPIPE
_RESULTS: ContextVar[TextIO | None] = ContextVar("results", default=None)
_heard: list[int] = []
_unread: list[int] = []


class _Results(io.FileIO):
    """A standard output that remembers that its reader is gone."""

    def write(self, data: Any) -> int:
        try:
            return super().write(data)
        except BrokenPipeError:
            _unread.append(len(data))
            raise


def note(*sentences: str) -> None:
    """Say something on the standard error stream, each sentence in a line of its own."""
    for sentence in sentences:
        print(f"hgogen: {printable(sentence)}", file=sys.stderr)


def printable(text: str) -> str:
    """A text in which what a terminal obeys and does not show, as of a file of somebody else, is written out."""
    return "".join(c if c.isprintable() or c in "\n\t\xa0" else repr(c)[1:-1] for c in text)


def listen() -> None:
    """Let Ctrl-C raise KeyboardInterrupt, in the process of a command; before, it ends it at once."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_DFL:
        signal.signal(signal.SIGINT, _interrupt)


def _interrupt(number: int, frame: Any) -> None:
    _heard.append(number)
    raise KeyboardInterrupt


def interrupted() -> bool:
    """Return whether there was a Ctrl-C."""
    return bool(_heard)


@contextmanager
def interruptible() -> Iterator[None]:
    """Within it, an error after a Ctrl-C is that Ctrl-C: of what a handler raises within its calls, CasADi makes errors
    of its own."""
    before = len(_heard)
    try:
        yield
    except Exception as error:
        if len(_heard) > before:
            raise KeyboardInterrupt from error
        raise


def set_apart() -> None:
    """Let descriptor 1 be another name of descriptor 2, and `sys.stdout` write to where descriptor 1 led."""
    if sys.stdout is None:  # it is closed, and no file is to take its number
        sys.stdout = io.TextIOWrapper(io.FileIO(os.open(os.devnull, os.O_WRONLY), "w"))
    try:
        ours = os.dup(1)
        os.dup2(os.open(os.devnull, os.O_WRONLY) if sys.stderr is None else 2, 1)
    except OSError:  # there is none, as under a service
        return
    raw = io.BufferedWriter(_Results(ours, "w"))
    sys.stdout = io.TextIOWrapper(raw, sys.stdout.encoding, "backslashreplace", line_buffering=raw.isatty())


def dropped() -> int:
    """Drop what is left to print, since nobody reads it; returns the exit status."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return UNREAD


def flushed(status: object) -> object:
    """The exit status after the last of the output."""
    if _unread:  # as of the help, which is printed, and ended, by typer
        return dropped()
    try:
        if sys.stdout is not None:
            sys.stdout.flush()
    except BrokenPipeError:
        return dropped()
    except OSError:  # as of a full disk, which was told where it was met
        dropped()
        return status or 2
    return status


def results() -> TextIO:
    """The stream of a command's results: what `sys.stdout` was when it began."""
    return _RESULTS.get() or sys.stdout


@contextmanager
def printing() -> Iterator[None]:
    """Within it, what is printed goes to the standard error stream, and `results` is where `sys.stdout` led."""
    token = _RESULTS.set(sys.stdout)
    try:
        with redirect_stdout(sys.stderr):
            yield
    finally:
        _RESULTS.reset(token)


class _Output(Console):
    def on_broken_pipe(self) -> None:
        """Leave it to the command."""
        raise BrokenPipeError


def console() -> Console:
    """The console of the results."""
    out = _Output(highlight=False, file=results())
    if not out.is_terminal and not os.environ.get("COLUMNS", "").isdigit():
        out.width = WIDTH
    return out
