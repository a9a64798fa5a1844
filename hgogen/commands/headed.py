"""What the tables of all commands share."""

from collections.abc import Iterable
from textwrap import wrap
from typing import Any

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from hgogen.commands.process import console

_NARROW = 10  # characters, at which words over a column of numbers begin a new line


def headed(title: str, *columns: str, numbers: int = 0) -> Table:
    """A table whose last `numbers` columns are flushed right, and never broken, as the text before them may be."""
    table = Table(
        title=title, box=None, pad_edge=False, padding=(0, 2, 0, 0), min_width=min(len(title), console().width)
    )
    table.title_justify, table.title_style = "left", "bold"
    for name in columns[: len(columns) - numbers]:
        table.add_column(name, overflow="fold")
    for name in columns[len(columns) - numbers :]:
        table.add_column("\n".join(wrap(name, _NARROW)), justify="right", overflow="fold", no_wrap=True)
    return table


def file_list(paths: Iterable[Any]) -> RenderableType:
    """The files written."""
    return Group(Text("files", style="bold"), *(Text(f"  {path}", no_wrap=True, overflow="ignore") for path in paths))
