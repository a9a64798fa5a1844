"""What a command prints and writes: tables, a progress bar, the files of a folder."""

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from textwrap import wrap
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

from rich.console import Console, Group, RenderableType
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
from rich.table import Table
from rich.text import Text

from hgogen.commands.process import console, results
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

    def tick(self, following: str | None = None) -> None:
        """One more is done; what comes next may have a name of its own."""
        self.update(self._only, advance=1, description=following)

    def advance_by(self, done: int) -> None:
        """So many more are done."""
        self.advance(self._only, done)

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
