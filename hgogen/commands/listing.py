"""The command `list`: what there is of each kind."""

import hgogen as hg
from hgogen.commands import tables
from hgogen.commands.command import Json, command, show
from hgogen.model import summary
from hgogen.modelfiles.place import available
from hgogen.registry import summaries


@command()
def list_(as_json: Json = False) -> None:
    """List the models found in models/ and those that come with hgogen, and the forms, observers, methods and targets
    there are.

    JSON keys: models (what to give as MODEL: paths of those in models/, names of those that come with hgogen), forms,
    observers, methods, targets (names), summaries (of each: what it is in one line).
    """
    kinds = ("forms", "observers", "methods", "targets")
    cases = {kind: summaries(f"hgogen.{kind}", getattr(hg, kind).__all__) for kind in kinds}
    known = {"models": {name: summary(path) for name, path in available().items()}, **cases}
    show(as_json, {**{kind: list(each) for kind, each in known.items()}, "summaries": known}, tables.listed(known))
