"""The commands that make no observer: `list`, `new` and `schema`, for the cases of each kind, a new model file and the
keys of JSON.

The listed cases are not imported, nor are the modules that compute.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.text import Text

from hgogen.commands.app import command_of, known
from hgogen.commands.command import Report, command, meanings
from hgogen.commands.output import Folder, Written, headed, print_result
from hgogen.modelfiles.place import available, new_model
from hgogen.modelfiles.place import summary as meaning
from hgogen.modelfiles.setting import demand_known
from hgogen.registry import cases, summary

_KINDS = ("forms", "observers", "methods", "targets")


@dataclass(frozen=True)
class Inventory(Report):
    """The names of all forms, observers, methods, targets and models."""

    models: Annotated[tuple[str, ...], "what to give as MODEL: paths in models/, names of those that come with hgogen"]
    forms: Annotated[tuple[str, ...], "names of the forms"]
    observers: Annotated[tuple[str, ...], "names of the observers"]
    methods: Annotated[tuple[str, ...], "names of the methods"]
    targets: Annotated[tuple[str, ...], "names of the targets"]
    summaries: Annotated[dict[str, dict[str, str]], "of each kind, what each is in one line"]

    def tables(self) -> Iterator[Any]:
        """Yield a table with a row for each form, observer, method, target and model."""
        table = headed("", "", "", "")
        for kind, each in self.summaries.items():
            for k, (name, text) in enumerate((each or {"none": ""}).items()):
                table.add_row("" if k else kind, name, Text(text))
        yield table


@command(Inventory)
def list_() -> Inventory:
    """List the models found in models/ and those that come with hgogen, and the forms, observers, methods and targets
    there are."""
    known = {"models": {name: meaning(path) for name, path in available().items()}}
    known |= {kind: {name: summary(kind, name) for name in cases(kind)} for kind in _KINDS}
    return Inventory(**{kind: tuple(each) for kind, each in known.items()}, summaries=known)


@dataclass(frozen=True)
class Begun(Report):
    """A new model file."""

    model: Annotated[str, "name of the model"]
    files: Written


@command(Begun)
def new_(
    name: Annotated[str, typer.Argument(metavar="NAME", help="The name of the model, of its file and of its C.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the file; by default this one.")] = Path(),
) -> Begun:
    """Write NAME.py, a small model that builds at once, each part explained by a comment. The argument may also be
    NAME.py. An existing file is never replaced."""
    name = name.removesuffix(".py")
    return Begun(name, tuple(Folder(out).write(new_model(name, out))))


@command()
def schema_(
    name: Annotated[str, typer.Argument(metavar="COMMAND", help="A command that has --json, such as run; or model.")],
) -> None:
    """Print every key of the JSON that a command prints, with its type and what it means. Keys of objects stand below
    them, further to the right. A command with several kinds of answer has a table for each, such as `simulate` with and
    without a campaign. `hgogen schema model` prints the JSON Schema of text models, for an editor.
    """
    if name == "model":
        from hgogen.modelfiles.text_schema import text_schema  # slow to import

        print_result(True, text_schema())
        return
    demand_known("command", name, (*known(), "model"))
    reports = getattr(command_of(name), "reports", ())
    if not reports:
        raise typer.BadParameter(f"{name} has no --json", param_hint="COMMAND")
    for report in reports:
        title = f"hgogen {name} --json: {(report.__doc__ or '').split('. ')[0].rstrip('.')}"
        table = headed(" ".join(title.split()), "key", "type", "meaning")
        for one in meanings(report):
            kind = f"{one.kind}, or left out" if one.optional else one.kind
            table.add_row(Text("  " * one.depth + one.name), Text(kind), Text(one.text))
        print_result(False, None, table, "")
