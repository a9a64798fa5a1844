"""The command `schema`: the keys of the JSON of a command, each with its type and what it means."""

from typing import Annotated

import typer
from rich.text import Text

from hgogen.commands.app import command_of, known
from hgogen.commands.command import command
from hgogen.commands.keys import meanings
from hgogen.commands.output import headed, show
from hgogen.modelfiles.setting import demand_known


@command()
def schema_(
    name: Annotated[str, typer.Argument(metavar="COMMAND", help="A command that has --json, such as run.")],
) -> None:
    """Print every key of the JSON that a command prints, with its type and what it means. Keys of objects stand below
    them, further to the right. A command with several kinds of answer has a table for each, such as `simulate` with and
    without a campaign.
    """
    demand_known("command", name, known())
    reports = getattr(command_of(name), "reports", ())
    if not reports:
        raise typer.BadParameter(f"{name} has no --json", param_hint="COMMAND")
    for report in reports:
        title = f"hgogen {name} --json: {(report.__doc__ or '').split('. ')[0].rstrip('.')}"
        table = headed(" ".join(title.split()), "key", "type", "meaning")
        for one in meanings(report):
            kind = f"{one.kind}, or left out" if one.optional else one.kind
            table.add_row(Text("  " * one.depth + one.name), Text(kind), Text(one.text))
        show(False, None, table, "")
