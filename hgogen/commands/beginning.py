"""The command `new`: a model file to begin with."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from hgogen.commands.command import Report, command
from hgogen.commands.output import Folder, Written
from hgogen.modelfiles import template


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
    """Write NAME.py, a small model that builds at once, each part explained by a comment; NAME.py is taken for its name
    as well. A file that is there is never replaced.
    """
    name = name.removesuffix(".py")
    return Begun(name, tuple(Folder(out).write(template.model(name, out))))
