"""The command `list`: what there is of each kind. Nothing of it is imported, nor is what computes."""

from rich.text import Text

from hgogen.commands.command import Json, command, show
from hgogen.commands.headed import headed
from hgogen.modelfiles.place import available
from hgogen.modelfiles.place import summary as meaning
from hgogen.registry import cases, summary


@command()
def list_(as_json: Json = False) -> None:
    """List the models found in models/ and those that come with hgogen, and the forms, observers, methods and targets
    there are.

    JSON keys: models (what to give as MODEL: paths of those in models/, names of those that come with hgogen), forms,
    observers, methods, targets (names), summaries (of each: what it is in one line).
    """
    kinds = ("forms", "observers", "methods", "targets")
    known = {"models": {name: meaning(path) for name, path in available().items()}}
    known |= {kind: {name: summary(kind, name) for name in cases(kind)} for kind in kinds}
    table = headed("", "", "", "")
    for kind, each in known.items():
        for k, (name, text) in enumerate((each or {"none": ""}).items()):
            table.add_row("" if k else kind, name, Text(text))
    show(as_json, {**{kind: list(each) for kind, each in known.items()}, "summaries": known}, table)
