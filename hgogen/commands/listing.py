"""The commands that make no observer: `list`, `new` and `schema`, for the cases of each kind, a new model file and the
keys of JSON; and `recheck`, which verifies a certificate again.

The listed cases are not imported, nor are the modules that compute.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Group
from rich.text import Text

from hgogen.commands.app import command_of, known
from hgogen.commands.command import Report, command, meanings
from hgogen.commands.output import Folder, Written, headed, print_result
from hgogen.modelfiles.place import available, new_model
from hgogen.modelfiles.place import summary as meaning
from hgogen.modelfiles.setting import demand_known
from hgogen.reading.files import content_of
from hgogen.recheck.file import DIGEST_DIGITS, LARGEST
from hgogen.recheck.verification import CannotRead, Rechecked, recheck
from hgogen.registry import cases, summary

_KINDS = ("forms", "observers", "methods", "targets")


@dataclass(frozen=True)
class Inventory(Report):
    """The cases of each kind."""

    models: Annotated[tuple[str, ...], "what to give as MODEL: paths in models/, names of those that come with hgogen"]
    forms: Annotated[tuple[str, ...], "names of the forms"]
    observers: Annotated[tuple[str, ...], "names of the observers"]
    methods: Annotated[tuple[str, ...], "names of the methods"]
    targets: Annotated[tuple[str, ...], "names of the targets"]
    summaries: Annotated[dict[str, dict[str, str]], "of each kind, what each is in one line"]

    def tables(self) -> Iterator[Any]:
        """Yield a row for each case."""
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
    """Write NAME.py, a small model that builds at once, each part explained by a comment; NAME.py is taken for its name
    as well. A file that is there is never replaced.
    """
    name = name.removesuffix(".py")
    return Begun(name, tuple(Folder(out).write(new_model(name, out))))


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
        print_result(False, None, table, "")


_COLOURS = {"verified": "green", "fails": "red"}


@dataclass(frozen=True)
class Verification(Report):
    """The report of a certificate that was verified."""

    json_keys = (
        "plant=outcome.plant form=outcome.form observer model=outcome.model verified counts=outcome.counts "
        "claims=outcome.rows unexamined=outcome.unexamined points=outcome.points"
    )

    outcome: Rechecked

    @property
    def observer(self) -> str | None:
        """Name of the observer; null without one."""
        return self.outcome.observer or None

    @property
    def verified(self) -> bool:
        """Whether a claim is verified, and none fails."""
        return bool(self.outcome.verified and not self.outcome.failed)

    def tables(self) -> Iterator[Any]:
        """Yield a row for each claim."""
        outcome = self.outcome
        of = f", {outcome.observer} observer" if outcome.observer else ""
        head = f"{outcome.plant}, {outcome.form} form{of}"
        table = headed(head, "found", "claim", "what was shown", "boxes", numbers=1)
        for row in outcome.rows:
            word = Text(f"{row.verdict}, verified" if row.found == "verified" else row.found)
            word.stylize(_COLOURS.get(row.found, "yellow"))
            sentence = f"{row.verdict}: {row.sentence}" if row.found in ("open", "stated") else row.sentence
            table.add_row(word, Text(row.id), Text(sentence), str(row.boxes or ""))
        lines = (*outcome.remarks, f"model {outcome.model[:DIGEST_DIGITS]}", outcome.count)
        yield Group(table, "", *map(Text, lines))

    def demand(self) -> None:
        """Raise an error if a claim fails or none is verified."""
        self.outcome.demand()


@command(Verification)
def recheck_(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A certificate that hgogen check wrote.")],
) -> Verification:
    """Verify a certificate again, by other code and another arithmetic than those that wrote it.

    Exit status: 0 every claim that is said to be proved or refuted is verified, 1 one of them is not or there is none,
    2 the file is no certificate. The model's digest is that in the banner of its C; the file's digest is no signature.
    """
    try:
        text = content_of(file, LARGEST).decode()
    except UnicodeDecodeError:
        raise CannotRead(str(file), "is no text in UTF-8") from None
    return Verification(recheck(text))
