"""The command `check`: the claims of one model, or the answers to many."""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table
from typer.core import TyperCommand

import hgogen as hg
from hgogen.analysis.undefined import undefined_slopes, undefined_values
from hgogen.check import Refuted
from hgogen.commands import findings, library, tables
from hgogen.commands.advice import advice
from hgogen.commands.checked import Checked, checked
from hgogen.commands.command import Bar, Tuned, command, json_text, show
from hgogen.commands.latex import fragment
from hgogen.commands.process import note, results
from hgogen.errors import HgogenError
from hgogen.model import Model, load
from hgogen.modelfiles.setting import AS_WRITTEN, Setting
from hgogen.sentence import encoded
from hgogen.target import demand as demand_place
from hgogen.trial import Trial
from hgogen.trials.sight import Sight, sight

CertificateFile = Annotated[
    Path | None, typer.Option("--certificate", metavar="FILE", help="Write what is proved as a certificate, JSON.")
]
JsonFile = Annotated[
    str | None, typer.Option("--json", metavar="[FILE]", help="Print JSON alone; --json=FILE writes it into FILE.")
]
_PRINTED = "-"  # the standard output, in the place of a file


class OptionalFile(TyperCommand):
    """A command whose --json takes a file where --library is given; else it is a flag, as everywhere."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Give a bare --json its value."""
        several = any(arg.split("=")[0] == "--library" for arg in args)
        words: list[str] = []
        for arg, following in zip(args, [*args[1:], None], strict=False):
            bare = arg == "--json" and (not several or following is None or following.startswith("-"))
            words.append(f"--json={_PRINTED}" if bare else arg)
        return super().parse_args(ctx, words)


@command(OptionalFile)
def check_(
    model: Annotated[
        str | None, typer.Argument(metavar="[MODEL]", help="A model file, or the name of one that `hgogen list` shows.")
    ] = None,
    certificate: CertificateFile = None,
    latex: Annotated[bool, typer.Option("--latex", help="Print the equations and the checks as LaTeX.")] = False,
    bounds: Annotated[
        list[str] | None,
        typer.Option("--bound", metavar="EXPR", help="The range of an expression on the declared box; repeat it."),
    ] = None,
    observer: Tuned = None,
    setting: Setting = AS_WRITTEN,
    deep: Annotated[bool, typer.Option("--deep", help="Ask the forms too that may take seconds.")] = False,
    many: Annotated[
        Path | None, typer.Option("--library", metavar="FILE", help="Answer every model of a JSON file.")
    ] = None,
    limit: Annotated[
        float | None,
        typer.Option(min=0.1, help=f"Processor seconds for each model of a library, by default {library.LIMIT:g}."),
    ] = None,
    as_json: JsonFile = None,
) -> None:
    """Print what is observable, which forms the plant is in and why not in the others, and what is claimed of the
    model's form and observer, each claim with its verdict.

    JSON keys: model, headline (the whole in one line), observability (known, joint: rank, dimension, order of
    derivatives, observable, unobservable, those proved_unobservable, symmetries, repairs, of the branch where most is
    observable: where, its conditions; elsewhere: the same of the branches that hide something; joint is null where no
    parameter has a range; method, asked: of which branches, checks; least_seen: the direction of the state that the
    outputs show least, null where it is not measured: least, median, window, unit, trial, by_motion, hopeless, where,
    direction), forms (name, verdict: null where the form was not asked or does not take the plant, why, why_data, fix,
    order, witness), bounds (expression, low, high: null where unbounded, defined, boxes, note), plant, form,
    coordinates, flow, outputs (expressions by name: z, z', y), gains (by name, those of several coordinates or outputs
    by the name of each), dt (dt, time, certified: the largest at which errors are proved to decay, throughout: at every
    one up to it, advised, refused: above it, each null where there is none; null of an observer of which it cannot be
    proved), checks (id, claim, verdict, reason, reason_data: its pattern and the values that it names, a bound as its
    value and how it is rounded, witness, fix, accepted), refuted (ids of refuted checks that nobody accepted; of a
    model with an observer the exit status is 1 if there are any), theorem (conclusion, reference, hypotheses: claim,
    verdict or "left to you", reason, reason_data, checks, reference; null without an observer), undefined (checks of
    the plant's rows, and of their derivatives by the states, that have no finite value somewhere in the declared
    ranges, or may have none), singular (factors: whose zeros are the singular set, null where it is not known; inputs:
    those of them free of states; determinants and checks, one each for a zero set, which do not count for the exit
    status), take (the observers admitted, best first: observer, name of the tuning, form, known of its convergence,
    where to take it, line, proposed: whether the gains are a first proposal, operations, functions), advice
    (sentences), notes. With --library FILE, which holds {"models": [MODEL, ..]}, each MODEL a plain-text model, with
    "bound_queries": [expression, ..] beside its tables, or lists of names and expressions, {"name": "osc", "states":
    ["x1", "x2"], "f": ["x2", "-a*x1 + u"], "outputs": ["y"], "h": ["x1"], "inputs": ["u"], "known_params": ["a"],
    "unknown_params": [], "x_box": {"x1": [-1, 1]}, "u_box": {"u": [-1, 1]}, "param_ranges": {"a": [1, 2]},
    "bound_queries": ["x1**2"]}; all but name, states, f, h may be missing. The answer: an object from each model's name
    to its answers, null where there is none; error: what is wrong with the model; partial: the time limit struck.
    """
    if (model is None) == (many is None):
        raise typer.BadParameter("give a MODEL, or --library FILE", param_hint="MODEL")
    for option, file in (("--certificate", certificate), ("--json", _file(as_json))):
        if file is not None and file.is_dir():
            raise typer.BadParameter(f"{file} is a folder; give a file in it", param_hint=option)
        if file is not None:
            demand_place([file.name], file.parent)
    if certificate is not None and certificate == _file(as_json):
        raise typer.BadParameter("one file cannot be the certificate and the JSON", param_hint="--certificate")
    options = {
        "--certificate": certificate,
        "--latex": latex,
        "--bound": bounds,
        "--deep": deep,
        "--observer": observer,
        **dict(word.split(maxsplit=1) for word in setting.words),
    }
    unused = [name for name, value in ({"--limit": limit} if many is None else options).items() if value]
    if unused:
        reason = "is for --library" if many is None else "does nothing beside --library, and is for a MODEL"
        raise typer.BadParameter(reason, param_hint=unused[0])
    if many is not None:
        _library(many, limit or library.LIMIT, as_json)
        return
    _one(load(str(model)).set(setting), observer, bounds or (), deep, certificate, latex, as_json)


def _file(as_json: str | None) -> Path | None:
    """The file that --json names."""
    return None if as_json in (None, _PRINTED) else Path(str(as_json))


def _written(value: Any, path: Path) -> None:
    new = "" if path.parent.is_dir() else ", in a new folder"
    hg.write({path.name: json_text(value, indent=1) + "\n"}, path.parent)
    note(f"wrote {path}{new}")


def _one(
    loaded: Model,
    observer: str | None,
    bounds: Iterable[str],
    deep: bool,
    certificate: Path | None,
    latex: bool,
    as_json: str | None,
) -> None:
    plant, folded = loaded.plant, loaded.notes
    if observer is not None:
        loaded.tuned(observer)
    note(*folded)  # before anything is called proved

    def say(*parts: Any) -> None:
        """Print at once what is known, so that a model whose next part takes long, or fails, shows the others."""
        show(False, {}, *(() if latex or as_json else parts))

    ranges = {text: hg.bound(text, plant) for text in bounds}
    gaps = (*undefined_values(plant), *undefined_slopes(plant))
    if gaps:
        say(findings.undefined(gaps))
    seen = hg.observability(plant)
    least = _least(loaded) if seen.rank == seen.n else None
    try:
        forms = hg.survey(plant, deep=deep)
        claims = checked(loaded, forms, observer)
        first = findings.headline(seen, forms, claims, least)
        say(first, "")
    finally:
        say(tables.ranges(ranges), findings.observed(seen, least))
    say(tables.survey(forms, claims.checks))
    if claims.shown:
        say(tables.checks(claims.head, claims.checks, claims.accepted))
    singular = hg.singularity(plant)
    if seen.rank == seen.n:
        say(tables.checks(singular.head, singular.checks, ()))
    say(tables.theorem(claims.theorem, claims.hypotheses))
    written = loaded.set(AS_WRITTEN)  # what to take is asked of the file
    own = checked(written, forms, observer) if loaded.setting else claims
    take = None if latex else advice(written, seen, forms, own, deep=deep)
    if take:
        say(findings.taking(take))
    if latex:
        print(fragment(claims.form, claims.checks, claims.accepted) + singular.latex(), file=results())
    elif as_json:
        shown = {**seen.as_dict(), "least_seen": least}
        listed = [{"expression": text, **one.as_dict()} for text, one in ranges.items()]
        known = {"observability": shown, "forms": forms.as_dict(), "bounds": listed}
        whole = {"model": loaded.path, "headline": first, **known, **claims.as_dict(), "undefined": gaps}
        whole |= {"singular": singular.as_dict(), **(encoded(take) if take else {})}
        file = _file(as_json)
        _written(whole, file) if file else show(True, whole)
    note(*(sentence for sentence in claims.notes if sentence not in folded))
    if certificate is not None:
        _certify(claims, certificate)
    if claims.demanded and claims.open:
        raise Refuted(claims.open, claims.form, claims.accepted, plain=loaded.plain)


def _least(model: Model) -> Sight | None:
    """What the outputs show at least, along the model's first trial, else on its box; a note says why not."""
    trials: list[Trial | None] = [None]
    try:
        trials = [*(model.trials()[:1] if model.has("trial") else ()), None]
    except HgogenError as error:
        note(str(error))
    for trial in trials:
        try:
            return sight(model.plant, trial)
        except HgogenError as error:
            note(str(error))
    return None


def _certify(claims: Checked, path: Path) -> None:
    from hgogen.certificates.certificate import asserted, certificate, stated

    content = certificate(claims.form, claims.checks, claims.observer)
    hg.write({path.name: json.dumps(content, indent=1, ensure_ascii=True) + "\n"}, path.parent)
    again = f"hgogen recheck {path} verifies it again" if asserted(content) else "nothing in it can be verified again"
    note(f"wrote {path}; {again}")
    for id, reason in stated(content):
        note(f"{path} only states {id}, it cannot be verified again: {reason}")


def _library(path: Path, limit: float, out: str | None) -> None:
    """Answer all models of a file; the table says how many have which answer, and what is wrong with the others."""
    models = library.read(path)
    with Bar("models", len(models)) as bar:
        answers = library.check(models, limit=limit, tick=bar.tick)
    table = Table("field", "true", "false", "other", "no answer", box=None, title=f"{len(answers)} models")
    for field in library.FIELDS:
        values = [answer[field] for answer in answers.values()]
        true, false, none = (sum(value is kind for value in values) for kind in (True, False, None))
        table.add_row(field, *map(str, (true, false, len(values) - true - false - none, none)))
    for name, answer in answers.items():
        if "error" in answer:
            table.add_row(f"{name}: {answer['error']}")
    file = _file(out)
    _written(answers, file) if file else show(out is not None, answers, table)
    bad = sum("error" in answer for answer in answers.values())
    if bad:
        note(f"{bad} of {len(answers)} models {'has an error' if bad == 1 else 'have errors'}")
