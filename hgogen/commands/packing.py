"""The options --for and --name of the commands that write code, and the folder that --for asks for."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from hgogen.commands.output import Folder
from hgogen.emit.naming import demand_prefix
from hgogen.emit.syntax import Real
from hgogen.extras.ecosystem import ALL, chosen, known
from hgogen.extras.folder import SOURCES, folder
from hgogen.reading.files import BYTES, Unread, content_of
from hgogen.step import Step
from hgogen.target import CannotWrite, Files

COSTS = "cost.json"
EXTRAS = "extras"  # where a library has what is no part of it, as Arduino calls it
_MARK = "hgogen"  # in what hgogen writes

For = Annotated[
    str | None,
    typer.Option(
        "--for",
        metavar="NAME",
        help=f"A folder that a project takes as it is, for {', '.join(known())}, several with commas, or {ALL}.",
    ),
]
Prefix = Annotated[
    str | None,
    typer.Option("--name", metavar="PREFIX", help="What files, functions, types and macros begin with."),
]


def demand_packing(ecosystems: str | None, name: str | None, target: str, c: str) -> None:
    """Raises: `BadParameter` where a folder is asked for of another language than C; `UnknownEcosystem`,
    `ReservedName`, and as `demand_prefix` does."""
    demand_prefix(name)
    if ecosystems is None:
        return
    if target != c:
        raise typer.BadParameter(f"is for {c}, not for {target}; leave one of the two", param_hint="--for")
    chosen(ecosystems, name or "")


def packed(step: Step, files: Files, ecosystems: str | None, real: Real, where: Folder) -> Files:
    """The files as they go into the folder: as they are, or laid out for ecosystems with what these ask for, and with
    the costs that are known there.

    Raises: `UnknownEcosystem`, `ReservedName`; `CannotWrite` for a folder that holds what is not hgogen's.
    """
    if ecosystems is None:
        return files
    made = folder(step, files, chosen(ecosystems, step.name), real=real, costs=_costs(where))
    _demand_own(where, made)
    return made


def beside(files: Mapping[str, bytes], ecosystems: str | None) -> dict[str, bytes]:
    """Figures, as they go into the folder."""
    return {f"{EXTRAS}/{name}" if ecosystems else name: content for name, content in files.items()}


def _costs(where: Folder) -> Mapping[str, Any] | None:
    """What `hgogen cost` wrote there, if it did."""
    (path,) = where.demand(COSTS)
    try:
        costs = json.loads(content_of(path, BYTES))
    except (Unread, ValueError, RecursionError):
        return None
    return costs if isinstance(costs, dict) else None


def _demand_own(where: Folder, made: Files) -> None:
    """Nothing is replaced that hgogen did not write, and no other source lies where every build compiles all."""
    for path, text in zip(where.demand(*made), made.values(), strict=True):
        if path.exists() and _MARK in text and _MARK.encode() not in content_of(path, BYTES):
            raise CannotWrite(str(path), "hgogen did not write what is there", "take another folder by --out")
    source = where.demand(f"{SOURCES}/{COSTS}")[0].parent
    names = {Path(name).name for name in made}
    if others := sorted(path.name for path in source.glob("*") if path.name not in names):
        reason = f"it holds {others[0]} too, which a build would compile along"
        raise CannotWrite(str(source), reason, "remove that, or take another folder by --out")
