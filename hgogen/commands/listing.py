"""The command `list`: what there is of each kind. Nothing of it is imported, nor is what computes."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any

from rich.text import Text

from hgogen.commands.command import Report, command
from hgogen.commands.output import headed
from hgogen.modelfiles.place import available
from hgogen.modelfiles.place import summary as meaning
from hgogen.registry import cases, summary

_KINDS = ("forms", "observers", "methods", "targets")


@dataclass(frozen=True)
class Inventory(Report):
    """What there is."""

    models: Annotated[tuple[str, ...], "what to give as MODEL: paths in models/, names of those that come with hgogen"]
    forms: Annotated[tuple[str, ...], "names of the forms"]
    observers: Annotated[tuple[str, ...], "names of the observers"]
    methods: Annotated[tuple[str, ...], "names of the methods"]
    targets: Annotated[tuple[str, ...], "names of the targets"]
    summaries: Annotated[dict[str, dict[str, str]], "of each kind, what each is in one line"]

    def tables(self) -> Iterator[Any]:
        """A row for each."""
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
