"""The output of a command: results on the standard output, tables, a progress bar, the files of a folder, and Ctrl-C,
which differs from a KeyboardInterrupt that a model raises.
"""

import copy
import io
import json
import math
import os
import signal
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, redirect_stdout
from contextvars import ContextVar
from dataclasses import dataclass, replace
from pathlib import Path
from textwrap import wrap
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, TextIO, TypeVar

from rich.console import Console, ConsoleOptions, Group, RenderableType, RenderResult
from rich.measure import Measurement
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Column, Table
from rich.text import Text

from hgogen.sentence import Encoded, by_reason, encoded
from hgogen.target import demand, lines_of, remove, write

if TYPE_CHECKING:  # which takes a second to import
    from hgogen.model import Model


Written = Annotated[tuple[Path, ...], "paths of the files written"]
Reported = TypeVar("Reported", bound=Encoded)
_NARROW = 10  # characters, the width at which headers of number columns are wrapped


def print_result(as_json: bool, value: Any, *tables: Any) -> None:
    """Print the result `value` as JSON alone, or the tables in its place."""
    if as_json:
        print(json_text(value), file=results())
        return
    for part in tables:
        console().print(part, crop=False)  # a line of code, or a path, stays whole


def json_text(value: Any, indent: int = 2) -> str:
    """Return a value as JSON text; `encoded` turns reports and numpy numbers into JSON's types."""
    return json.dumps(encoded(value), indent=indent, allow_nan=False)


class _Continued(Table):
    """A table whose last `numbers` columns go on below, after the text columns again, where they do not fit."""

    numbers: int

    def part(self, columns: Iterable[Column]) -> Table:
        """Return the table of some of the columns, without the title."""
        table = copy.copy(self)
        table.columns = [replace(column, _index=k) for k, column in enumerate(columns)]
        table.title = table.min_width = None
        return table

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Yield the parts, each with the columns that fit."""
        split = len(self.columns) - self.numbers
        texts, parts, width = self.columns[:split], [list[Column]()], 0

        def width_of(columns: Iterable[Column]) -> int:
            return Measurement.get(console, options, self.part(columns)).maximum + self.padding[1]

        room = options.max_width - min(width_of(texts), options.max_width // 2)
        for column in self.columns[split:]:
            own = width_of([column])
            if width + own > room and parts[-1]:
                parts.append([])
                width = 0
            width += own
            parts[-1].append(column)
        for k, columns in enumerate(parts):
            table = self.part([*texts, *columns])
            if k:
                yield ""
            else:
                table.title, table.min_width = self.title, self.min_width
            yield from Table.__rich_console__(table, console, options)


def headed(title: str, *columns: str, numbers: int = 0, rows: Iterable[Iterable[RenderableType]] = ()) -> Table:
    """Return a table with a title and columns; the last `numbers` columns are right-aligned and never broken."""
    table = _Continued(
        title=title, box=None, pad_edge=False, padding=(0, 2, 0, 0), min_width=min(len(title), console().width)
    )
    table.numbers = numbers
    table.title_justify, table.title_style = "left", "bold"
    for name in columns[: len(columns) - numbers]:
        table.add_column(name, overflow="fold")
    for name in columns[len(columns) - numbers :]:
        table.add_column("\n".join(wrap(name, _NARROW)), justify="right", overflow="fold", no_wrap=True)
    for row in rows:
        table.add_row(*row)
    return table


def filled(table: Table) -> list[RenderableType]:
    """Return a table and an empty line; nothing for a table without rows."""
    return [table, ""] if table.row_count else []


def file_list(paths: Iterable[Any]) -> RenderableType:
    """Return the list of the written files."""
    return Group(Text("files", style="bold"), *(Text(f"  {path}", no_wrap=True, overflow="ignore") for path in paths))


class Bar(Progress):
    """A progress bar with the remaining time, on the standard error stream if that is a terminal; `total`: the number
    of steps, None if unknown."""

    def __init__(self, what: str, total: int | None) -> None:
        err = Console(stderr=True)
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
        options: dict[str, Any] = {"transient": True, "disable": not err.is_terminal, "speed_estimate_period": math.inf}
        super().__init__(*columns, console=err, **options)
        self._only = self.add_task(what, total=total)

    def tick(self, following: str | None = None, done: int = 1) -> None:
        """Count `done` more steps; `following`: the name of the next stage."""
        self.update(self._only, advance=done, description=following)

    def reach(self, done: int) -> None:
        """Set the number of steps done."""
        self.update(self._only, completed=done)


def rendered(drawn: Mapping[str, Any]) -> dict[str, bytes]:
    """Return the image files of figures (`drawn`, by name) by file name. Display a progress bar."""
    from hgogen.run import figures as figure

    files: dict[str, bytes] = {}
    with Bar("figures", len(drawn)) as bar:
        for name, one in drawn.items():
            files |= figure.files(name, one)
            bar.tick()
    return files


@dataclass(frozen=True)
class Folder:
    """The folder of a command's results: `root`, which the user named (by default `build`), with the subfolder
    `below`."""

    root: Path
    below: str = ""

    def demand(self, *names: str) -> list[Path]:
        """Return the paths of files with these names. Raises: `CannotWrite` if the files cannot be written."""
        return demand(map(self._within, names), self.root)

    def write(self, files: Mapping[str, str | bytes]) -> list[Path]:
        """Write all files by name, or none, and return their paths. Raises: `CannotWrite`."""
        return write({self._within(name): content for name, content in files.items()}, self.root)

    def remove(self, name: str) -> None:
        """Remove a file if it exists. Raises: `CannotWrite`."""
        remove(self._within(name), self.root)

    def lines(self, name: str) -> AbstractContextManager[tuple[Iterator[str], Callable[[str], None]]]:
        """Return the lines of a file and a function that appends a line, as `target.lines_of`. Raises:
        `CannotWrite`."""
        return lines_of(self._within(name), self.root)

    def save(
        self,
        report: Reported,
        name: str,
        files: Mapping[str, str | bytes] = MappingProxyType({}),
        more: Iterable[Path] = (),
    ) -> Reported:
        """Write files, and the report as JSON into the file `name`; return the report with all paths, and the paths
        `more`, in its `files`. Raises: `CannotWrite`."""
        paths = (*self.demand(*files, name), *more)
        complete: Reported = replace(report, files=paths)  # type: ignore[type-var]
        self.write({**files, name: json_text(complete) + "\n"})
        return complete

    def _within(self, name: str) -> str:
        return f"{self.below}/{name}" if self.below else name


def folder_of(out: Path | None, model: "Model", observer: str | None = None) -> Folder:
    """Return the folder --out, by default build/MODEL, or build/MODEL_OBSERVER if a tuning is named."""
    return Folder(Path("build"), named(model, observer)) if out is None else Folder(out)


def named(model: "Model", observer: str | None) -> str:
    """Return the name of the folder of results: the model's, with the tuning's appended if one is named."""
    return f"{model.name}_{observer}" if observer else model.name


def refusals_table(refused: Mapping[str, str], title: str = "without gains") -> list[RenderableType]:
    """Return a table of the observers without gains or step, with the reason of each; empty if `refused` is."""
    rows = ((Text(", ".join(names)), Text(why)) for why, names in by_reason(refused.items()).items())
    return filled(headed(title, "observers", "why", rows=rows))


def cell(value: float | None) -> str:
    """Return a number as text; empty for None and NaN."""
    return "" if value is None or math.isnan(value) else f"{value:.4g}"


WIDTH = 110  # characters, if the output is no terminal and COLUMNS is not set
INTERRUPTED = 130  # the exit status after Ctrl-C, as a shell gives it: 128 + SIGINT
UNREAD = 141  # the exit status if the reader of the output has closed it: 128 + SIGPIPE
_RESULTS: ContextVar[TextIO | None] = ContextVar("results", default=None)
_interrupts: list[int] = []
_unread: list[int] = []


class _Results(io.FileIO):
    """A standard output that records that its reader has closed it, as `| head` does."""

    def write(self, data: Any) -> int:
        try:
            return super().write(data)
        except BrokenPipeError:
            _unread.append(len(data))
            raise


def note(*sentences: str) -> None:
    """Print each sentence on a line of its own, on the standard error stream."""
    for sentence in sentences:
        print(f"hgogen: {printable(sentence)}", file=sys.stderr)


def printable(text: str) -> str:
    """Return text with control characters escaped, such as those in a file from somebody else."""
    return "".join(c if c.isprintable() or c in "\n\t\xa0" else repr(c)[1:-1] for c in text)


def listen() -> None:
    """Let Ctrl-C raise KeyboardInterrupt from now on; until then it ends the process without a message."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_DFL:
        signal.signal(signal.SIGINT, _interrupt)


def _interrupt(number: int, frame: Any) -> None:
    _interrupts.append(number)
    raise KeyboardInterrupt


def interrupted() -> bool:
    """Return whether the user has pressed Ctrl-C."""
    return bool(_interrupts)


@contextmanager
def interruptible() -> Iterator[Callable[[], None]]:
    """Turn an error after a Ctrl-C in the body into KeyboardInterrupt, since CasADi raises an error of its own. Yield a
    function that raises KeyboardInterrupt if CasADi has dropped one."""
    before = len(_interrupts)

    def check() -> None:
        if len(_interrupts) > before:
            raise KeyboardInterrupt

    try:
        yield check
    except Exception as error:
        if len(_interrupts) > before:
            raise KeyboardInterrupt from error
        raise


def set_apart() -> None:
    """Redirect the file descriptor 1 (standard output) to 2 (standard error), and let `sys.stdout` write to the former
    target of 1, so that output of C libraries does not mix with results."""
    if sys.stdout is None:  # it is closed; no file may take its number
        sys.stdout = io.TextIOWrapper(io.FileIO(os.open(os.devnull, os.O_WRONLY), "w"))
    try:
        ours = os.dup(1)
        os.dup2(os.open(os.devnull, os.O_WRONLY) if sys.stderr is None else 2, 1)
    except OSError:  # no descriptor 1, as under a service
        return
    raw = io.BufferedWriter(_Results(ours, "w"))
    sys.stdout = io.TextIOWrapper(raw, sys.stdout.encoding, "backslashreplace", line_buffering=raw.isatty())


def dropped() -> int:
    """Discard the remaining output, which has no reader any more, and return the exit status of the process."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return UNREAD


def flushed(status: object) -> object:
    """Flush the standard output and return the exit `status`, or that of an error if the output cannot be written."""
    if _unread:  # as with the help, which typer prints
        return dropped()
    try:
        if sys.stdout is not None:
            sys.stdout.flush()
    except BrokenPipeError:
        return dropped()
    except OSError:  # as with a full disk, which was reported already
        dropped()
        return status or 2
    return status


def results() -> TextIO:
    """Return the stream of a command's results: `sys.stdout` as it was when the command began."""
    return _RESULTS.get() or sys.stdout


@contextmanager
def printing() -> Iterator[None]:
    """Redirect `print` to the standard error stream within the body; `results` returns the former `sys.stdout`."""
    token = _RESULTS.set(sys.stdout)
    try:
        with redirect_stdout(sys.stderr):
            yield
    finally:
        _RESULTS.reset(token)


class _Output(Console):
    def on_broken_pipe(self) -> None:
        raise BrokenPipeError


def console() -> Console:
    """Return the rich console that prints a command's results."""
    out = _Output(highlight=False, file=results())
    if not out.is_terminal and not os.environ.get("COLUMNS", "").isdigit():
        out.width = WIDTH
    return out
