"""The command `new`: a model file to begin with."""

from pathlib import Path
from typing import Annotated

import typer

from hgogen.commands.command import Folder, Json, command, show
from hgogen.commands.headed import file_list
from hgogen.modelfiles import template


@command()
def new_(
    name: Annotated[str, typer.Argument(metavar="NAME", help="The name of the model, of its file and of its C.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the file; by default this one.")] = Path(),
    as_json: Json = False,
) -> None:
    """Write NAME.py, a small model that builds at once, each part explained by a comment; NAME.py is taken for its name
    as well. A file that is there is never replaced.

    JSON keys: model (the name), files.
    """
    name = name.removesuffix(".py")
    paths = Folder(out).write(template.model(name, out))
    show(as_json, {"model": name, "files": list(map(str, paths))}, file_list(paths))
