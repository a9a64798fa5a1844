"""The command `check`: the claims of one model, or the answers to many."""

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table
from typer.core import TyperCommand

import hgogen as hg
from hgogen import jobs, library, tables
from hgogen.answers import FIELDS
from hgogen.bounds import Range
from hgogen.check import demand
from hgogen.command import Bar, note, show
from hgogen.latex import fragment
from hgogen.model import Model, load

CertificateFile = Annotated[
    Path | None, typer.Option("--certificate", metavar="FILE", help="Write what is proved as a certificate, JSON.")
]
_PRINTED = "-"  # the standard output, in the place of a file


class OptionalFile(TyperCommand):
    """A command whose --json takes a file where --library is given; else it is a flag, as everywhere."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Give a bare --json its value."""
        several = any(arg.split("=")[0] == "--library" for arg in args)
        given: list[str] = []
        for arg, following in zip(args, [*args[1:], None], strict=False):
            bare = arg == "--json" and (not several or following is None or following.startswith("-"))
            given.append(f"--json={_PRINTED}" if bare else arg)
        return super().parse_args(ctx, given)


def check(
    model: Annotated[
        str | None, typer.Argument(metavar="[MODEL]", help="A model file, or the name of one in models/.")
    ] = None,
    certificate: CertificateFile = None,
    latex: Annotated[bool, typer.Option("--latex", help="Print the equations and the checks as LaTeX.")] = False,
    bounds: Annotated[
        list[str] | None,
        typer.Option("--bound", metavar="EXPR", help="The range of an expression on the declared box; repeat it."),
    ] = None,
    deep: Annotated[bool, typer.Option("--deep", help="Ask the forms too that may take seconds.")] = False,
    many: Annotated[
        Path | None, typer.Option("--library", metavar="FILE", help="Answer every model of a JSON file.")
    ] = None,
    limit: Annotated[
        float, typer.Option(min=0.1, help="Seconds for each model of a library; what was found is kept.")
    ] = library.LIMIT,
    as_json: Annotated[
        str | None, typer.Option("--json", metavar="[FILE]", help="Print JSON alone; of a library into FILE.")
    ] = None,
) -> None:
    """Print what is observable, which forms the plant is in and why not in the others, and what is claimed of the
    model's form and observer, each claim with its verdict.

    JSON keys: model, observability (known, joint: rank, dimension, order of derivatives, observable, unobservable,
    symmetries, repairs; joint is null where no parameter has a range; method, checks), forms (name, verdict: null where
    the form was not asked or does not take the plant, why, fix, order, witness), bounds (expression, low, high: null
    where unbounded, defined, boxes, note), plant, form, coordinates, flow, outputs (expressions by name: z, z', y),
    checks (id, claim, verdict, reason, witness, fix, accepted), refuted (ids of refuted checks that nobody accepted; of
    a model with an observer the exit status is 1 if there are any), theorem (conclusion, reference, hypotheses: claim,
    verdict or "left to you", reason, checks, reference; null without an observer), singular (factors: whose zeros are
    the singular set, null where it is not known; inputs: those of them free of states; determinants and checks, one
    each for a zero set, which do not count for the exit status), notes.

    With --library: an object from each model's name to its answers, null where there is no answer; error: what is
    wrong with the model; partial: the time limit struck.
    """
    if (model is None) == (many is None):
        raise typer.BadParameter("give a MODEL, or --library FILE", param_hint="MODEL")
    if many is not None:
        _library(many, limit, as_json)
        return
    _one(load(str(model)), bounds or (), deep, certificate, latex, as_json is not None)


def _one(
    loaded: Model, bounds: Iterable[str], deep: bool, certificate: Path | None, latex: bool, as_json: bool
) -> None:
    plant = loaded.plant

    def say(*parts: Any) -> None:
        """Print at once what is known, so that a model whose next part takes long shows the others."""
        show(False, {}, *(() if latex or as_json else parts))

    ranges = {text: hg.bound(text, plant) for text in bounds}
    say(tables.ranges(ranges))
    seen = hg.observability(plant)
    say(tables.observed(seen))
    forms = hg.survey(plant, deep=deep)
    claims = jobs.checked(loaded, forms.best)
    say(tables.survey(forms, claims.checks))
    if claims.shown:
        say(tables.checks(claims.head, claims.checks, claims.accepted))
    singular = hg.singularity(plant)
    if seen.rank == seen.n:
        say(tables.checks(singular.head, singular.checks, ()))
    say(tables.theorem(claims.theorem, claims.hypotheses))
    if latex:
        print(fragment(claims.form, claims.checks, claims.accepted) + singular.latex())
    elif as_json:
        told = {"observability": seen.as_dict(), "forms": forms.as_dict(), "bounds": _ranges(ranges)}
        show(True, {"model": loaded.path, **told, **claims.as_dict(), "singular": singular.as_dict()})
    for sentence in claims.notes:
        note(sentence)
    if certificate is not None:
        _certify(claims, certificate)
    if claims.demanded:
        demand(claims.checks, claims.accepted, claims.form)


def _ranges(found: Mapping[str, Range]) -> list[dict[str, Any]]:
    return [{"expression": text, **one.as_dict()} for text, one in found.items()]


def _certify(claims: jobs.Checked, path: Path) -> None:
    from hgogen.certificate import asserted, certificate, stated

    found = certificate(claims.form, claims.checks, claims.observer)
    hg.write({path.name: json.dumps(found, indent=1, ensure_ascii=True) + "\n"}, path.parent)
    again = f"hgogen recheck {path} verifies it again" if asserted(found) else "nothing in it can be verified again"
    note(f"wrote {path}; {again}")
    for id, reason in stated(found):
        note(f"{path} only states {id}, it cannot be verified again: {reason}")


def _library(path: Path, limit: float, out: str | None) -> None:
    models = library.read(path)
    with Bar("models", len(models)) as bar:
        found = library.check(models, limit=limit, tick=bar.tick)
    if out not in (None, _PRINTED):
        target = Path(str(out))
        hg.write({target.name: json.dumps(found, indent=1, allow_nan=False) + "\n"}, target.parent)
        note(f"wrote {target}")
        return
    show(out is not None, found, _summary(found))


def _summary(found: dict[str, dict[str, Any]]) -> Table:
    """How many models have which answer to each question, and what is wrong with the others."""
    table = Table("field", "true", "false", "other", "no answer", box=None, title=f"{len(found)} models")
    for field in FIELDS:
        given = [answer[field] for answer in found.values()]
        true, false, none = (sum(value is kind for value in given) for kind in (True, False, None))
        table.add_row(field, *map(str, (true, false, len(given) - true - false - none, none)))
    for name, answer in found.items():
        if "error" in answer:
            table.add_row(f"{name}: {answer['error']}")
    return table
